"""Held-out quality: PSNR-µ of the net and of the box estimate, for each cube."""

import torch

from .data import Dataset
from .graph import GraphNet, box_estimate
from .tone import psnr_mu, tone


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
