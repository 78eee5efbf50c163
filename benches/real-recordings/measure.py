"""What docs/real-recordings.md says of the authors' recordings, in numbers: nets beside the box filter.

    python benches/real-recordings/measure.py FOLDER [--pix2hdr target/release/pix2hdr] [--weights fast robust]

FOLDER holds `fan` and `window`, each with capture.npy, capture.json and paper_output.npy (the authors' 8-bit result, in
its own tone curve). `pix2hdr` synthesises each as recorded and with a fitted response; there is no ground truth. Only
NumPy is needed.
"""

import argparse
import json
import struct
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

TILE = (2, 4)  # rows and columns of mpve-1-4's tile
PERIOD = 8  # frames after which it repeats

# Smooth, static parts, as (rows, columns) of the 128×128 frames; whole tiles.
PARTS = {
    "fan": {"paper": ((116, 124), (8, 88)), "hub": ((34, 44), (36, 56))},
    "window": {
        "wall": ((10, 26), (72, 120)),
        "face": ((88, 104), (88, 104)),
        "dark box": ((106, 116), (4, 28)),
        "dark hair": ((28, 38), (100, 124)),
    },
}
CHART = ((64, 114), (16, 84))  # of `fan`: letters, digits and line pairs
WHITE = 0.97  # irradiance from which a pixel counts as white


def log_irradiance(video: np.ndarray) -> np.ndarray:
    """ln p; what is zero counts as 1e-5."""
    return np.log(np.maximum(video.astype(np.float64), 1e-5))


def cut(video: np.ndarray, part) -> np.ndarray:
    """The rows and columns of a part."""
    (top, bottom), (left, right) = part
    return video[:, top:bottom, left:right]


def pattern_residue(video: np.ndarray, part) -> float:
    """How much the positions of the tile differ: deviation over them of their mean log irradiance, less a plane."""
    mean = cut(log_irradiance(video), part).mean(0)
    y, x = np.indices(mean.shape)
    plane = np.stack([np.ones(mean.size), y.ravel(), x.ravel()], 1)
    mean = mean - (plane @ np.linalg.lstsq(plane, mean.ravel(), rcond=None)[0]).reshape(mean.shape)
    rows, columns = TILE
    return float(np.std([mean[dy::rows, dx::columns].mean() for dy in range(rows) for dx in range(columns)]))


def flicker(video: np.ndarray, part) -> float:
    """Mean over the pixels of the deviation of log irradiance over time."""
    return float(cut(log_irradiance(video), part).std(0).mean())


def sharpness(video: np.ndarray, part) -> float:
    """Mean horizontal gradient over mean irradiance."""
    seen = cut(video.astype(np.float64), part)
    return float(np.abs(np.diff(seen, axis=2)).mean() / seen.mean())


def seam(video: np.ndarray, hop: int) -> float:
    """Change from frame to frame across the edges of windows over that at the same phase of the pattern inside."""
    change = np.abs(np.diff(log_irradiance(video), axis=0)).mean((1, 2))  # [i]: from frame i to i + 1
    edges = [i for i in range(hop - 1, len(change), hop)]
    inside = [i for i in range(len(change)) if i % PERIOD == (hop - 1) % PERIOD and i not in edges]
    return float(change[edges].mean() / change[inside].mean())


def write_box_filter(path: Path) -> None:
    """A weights file whose graph is the box filter."""
    graph = {
        "version": 1,
        "name": "box filter",
        "pattern": "mpve-1-4",
        "window": {"frames": PERIOD, "lead": 0, "hop": PERIOD},
        "nodes": [{"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}],
        "output": "estimate",
    }
    metadata = {"format": "pix2hdr-weights/1", "graph": json.dumps(graph), "response": '"any"', "provenance": "{}"}
    header = json.dumps({"__metadata__": metadata}).encode()
    path.write_bytes(struct.pack("<Q", len(header)) + header)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, help="folder with `fan` and `window`")
    parser.add_argument("--pix2hdr", default="target/release/pix2hdr")
    parser.add_argument("--weights", nargs="+", default=["fast", "robust"], help="presets or weights files")
    parser.add_argument("--ensemble", default="1", help="views (default: 1)")
    arguments = parser.parse_args()

    def run(*words) -> str:
        done = subprocess.run([arguments.pix2hdr, *map(str, words)], capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{arguments.pix2hdr} {' '.join(map(str, words))}: {done.stderr.strip()}")
        return done.stdout

    hop = json.loads(run("weights", arguments.weights[0], "--json"))["window"]["hop"]
    columns = [f"{source}: {net}" for source in ("as recorded", "fitted") for net in ("box filter", *arguments.weights)]
    results = {}
    with tempfile.TemporaryDirectory() as scratch:
        box, fitted, out = (Path(scratch) / name for name in ("box.safetensors", "fitted", "result.npy"))
        write_box_filter(box)
        for name in PARTS:
            recorded = arguments.recordings / name / "capture.npy"
            run("import", recorded, "--fit-response", "--out", fitted / name)
            for column in columns:
                source, net = column.split(": ", 1)
                capture = recorded if source == "as recorded" else fitted / name / "capture.npy"
                weights, views = (box, 1) if net == "box filter" else (net, arguments.ensemble)
                run("synth", capture, "--weights", weights, "--ensemble", views, "--overwrite", "--out", out)
                results[name, column] = np.load(out)

    authors = {name: np.load(arguments.recordings / name / "paper_output.npy") for name in PARTS}

    def table(title: str, rows: list) -> None:
        print(f"\n{title}\n\n| | {' | '.join(columns)} |\n|---|{'--:|' * len(columns)}")
        for label, name, measure in rows:
            print(f"| {label} | {' | '.join(f'{measure(results[name, column]):.4f}' for column in columns)} |")

    parts = [(f"`{name}`: {label}", name, part) for name, found in PARTS.items() for label, part in found.items()]
    table("Pattern residue", [(label, name, partial(pattern_residue, part=part)) for label, name, part in parts])
    table("Flicker", [(label, name, partial(flicker, part=part)) for label, name, part in parts])
    others = [("`fan`: gradient on the chart", "fan", partial(sharpness, part=CHART))]
    others += [(f"`{name}`: change across windows / inside", name, partial(seam, hop=hop)) for name in PARTS]
    others += [(f"`{name}`: share of white pixels", name, lambda video: float((video >= WHITE).mean())) for name in PARTS]
    table("Others", others)
    print("\nThe authors' output\n\n| | pattern residue | flicker |\n|---|--:|--:|")
    for label, name, part in parts:
        print(f"| {label} | {pattern_residue(authors[name], part):.4f} | {flicker(authors[name], part):.4f} |")


if __name__ == "__main__":
    main()
