"""Held-out quality: PSNR-µ of the net and of the box estimate, for each cube.

`python -m pix2hdr_training.validate WEIGHTS DATASET…` scores a weights file on data sets of `pix2hdr dataset`.
"""

import argparse
import json
import sys
from pathlib import Path

import torch

from .data import Dataset
from .export import net_from_weights
from .graph import GraphNet
from .operations import box_estimate
from .tone import psnr_mu, tone


def check_pattern(graph: dict, dataset: Dataset) -> None:
    """ValueError where a net is for another pattern than a data set's."""
    pattern = dataset.meta.get("pattern")
    if graph["pattern"] not in ("any", pattern):
        raise ValueError(f"{graph['name']} is for pattern {graph['pattern']}, but {dataset.folder} has cubes of {pattern}")


def check_windows(graph: dict, dataset: Dataset) -> None:
    """ValueError where cubes hold no window of a net."""
    if not dataset.window_starts(graph["window"]):
        raise ValueError(f"{dataset.folder}: cubes of {dataset.frames} frames hold no window of {graph['window']}")


@torch.no_grad()
def validate(net: GraphNet, dataset: Dataset, cubes: int = 0) -> dict:
    """Scores over all windows of the first `cubes` cubes (0: all), on whole frames.

    Returns {"psnr_mu", "box_psnr_mu", "gain_db", "cubes", "kinds": {kind: {...}}}, means over cubes in dB. Frames
    are cropped at the bottom and right to the graph's granularity.
    """
    net.eval()
    window = net.graph["window"]
    device = next(net.parameters()).device
    rows, columns = net.granularity
    height, width = dataset.height // rows * rows, dataset.width // columns * columns
    starts = dataset.window_starts(window)
    by_kind: dict[str, list[tuple[float, float]]] = {}
    count = min(cubes, len(dataset)) if cubes else len(dataset)
    for cube in range(count):
        errors = torch.zeros(2, dtype=torch.float64)
        for start in starts:
            y, truth = dataset.read(cube, window, start, 0, 0, height, width)
            y = torch.from_numpy(y)[None].to(device)
            e = torch.from_numpy(dataset.exposure(window, start, height, width))[None].to(device)
            wanted = tone(torch.from_numpy(truth).to(device))
            irradiance = net(y, e)[0, 0]
            cut = slice(window["lead"], window["lead"] + window["hop"])
            box = box_estimate(y, e, net.inverse)[0, cut]
            for i, video in enumerate((irradiance, box)):
                errors[i] += (tone(video.clamp(0.0, 1.0)) - wanted).square().mean().double().cpu()
        pair = tuple(psnr_mu(float(v) / len(starts)) for v in errors)
        by_kind.setdefault(str(dataset.info(cube).get("kind", "unnamed")), []).append(pair)
    pairs = [pair for kind in by_kind.values() for pair in kind]
    return {**_means(pairs), "kinds": {kind: _means(pairs) for kind, pairs in sorted(by_kind.items())}}


def _means(pairs: list[tuple[float, float]]) -> dict:
    net = sum(p[0] for p in pairs) / len(pairs)
    box = sum(p[1] for p in pairs) / len(pairs)
    return {"psnr_mu": net, "box_psnr_mu": box, "gain_db": net - box, "cubes": len(pairs)}


def summary(scores: dict) -> str:
    """Scores as a line for people."""
    kinds = ", ".join(f"{kind} {s['gain_db']:+.2f}" for kind, s in scores["kinds"].items())
    return (
        f"{scores['psnr_mu']:.2f} dB PSNR-µ, box {scores['box_psnr_mu']:.2f}, gain {scores['gain_db']:+.3f} dB"
        f" over {scores['cubes']} cubes ({kinds})"
    )


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(prog="python -m pix2hdr_training.validate", description=__doc__)
    parser.add_argument("weights", type=Path, help="weights file")
    parser.add_argument("data", type=Path, nargs="+", help="data sets of held-out cubes")
    parser.add_argument("--cubes", type=int, default=0, help="the first N cubes of each (0: all)")
    parser.add_argument("--window", type=int, nargs=3, metavar=("FRAMES", "LEAD", "HOP"), help="other windows than the graph's, as in training")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="one JSON object: scores by data set")
    args = parser.parse_args(arguments)
    torch.set_num_threads(args.threads)
    window = dict(zip(("frames", "lead", "hop"), args.window, strict=True)) if args.window else None
    found = {}
    try:
        for folder in args.data:
            data = Dataset(folder)
            net = net_from_weights(args.weights, data.inverse, window)
            check_pattern(net.graph, data)
            check_windows(net.graph, data)
            found[str(folder)] = validate(net, data, args.cubes)
            if not args.json:
                print(f"{folder}: {summary(found[str(folder)])}", flush=True)
    except (OSError, ValueError) as error:
        print(f"validate: {error}", file=sys.stderr)
        return 1
    if args.json:
        print(json.dumps(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
