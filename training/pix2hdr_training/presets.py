"""The built-in layer graphs, and `python -m pix2hdr_training.presets`, which writes them as JSON."""

import argparse
import json
from pathlib import Path

from .layout import gflop_per_frame, granularity, needed_frames, parameter_count

LEAKY = {"leaky_relu": 0.2}


def conv(name, source, channels, kernel, *, stride=(1, 1, 1), activation="none", norm=False, add=None, transpose=False):
    """A convolution node; `kernel` and `stride` are (t, y, x)."""
    node = {
        "name": name,
        "op": "conv_transpose3d" if transpose else "conv3d",
        "inputs": [source],
        "out_channels": channels,
        "kernel": list(kernel),
        "stride": list(stride),
        "activation": activation,
        "norm": norm,
    }
    return node if add is None else {**node, "add": add}


def kernel_net(
    widths,
    blocks,
    *,
    name,
    pattern="mpve-1-4",
    period=8,
    hop=48,
    reach=2,
    fold=(2, 4),
    temporal=(3, 1, 1),
    channels=("log_irradiance", "log_estimate", "saturated"),
):
    """One net that predicts kernels: for each pixel weights over log irradiances around it, and a residual.

    A U-net on the pattern's folded tile. `widths` are those of its levels, each half as wide and high as the one before;
    `blocks` are the residual blocks of each level, half of them on the way down and half on the way up. A block is a
    convolution over `temporal` and one over 3×3 pixels. The taps are the pixels of the same frame that are at most
    `reach` away, and the same pixel half a period, a period and two frames before and after. The window's lead is all
    that the net reaches in time, so a result does not depend on where windows begin: `hop` can be as long as memory
    and latency allow.
    """
    steps = [-period, -period // 2, period // 2, period]
    near = range(-reach, reach + 1)
    taps = [[0, dy, dx] for dy in near for dx in near]
    taps += [[dt, 0, 0] for dt in sorted({*steps, -2, 2})]
    half, spatial = (1, 2, 2), (1, 3, 3)
    nodes = [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
        {"name": "log_irradiance", "op": "log_irradiance", "inputs": ["measurement"]},
        {
            "name": "features",
            "op": "features",
            "inputs": ["measurement", "estimate", "log_irradiance"],
            "channels": list(channels),
            "neighbours": steps,
            "block": [1, *fold],
        },
        conv("entry", "features", widths[0], spatial, activation=LEAKY),
    ]
    last, skips = "entry", []

    def residual(last: str, level: int, indices) -> str:
        for i in indices:
            a, b = f"level{level}block{i}a", f"level{level}block{i}b"
            nodes.append(conv(a, last, widths[level], temporal, activation=LEAKY))
            nodes.append(conv(b, a, widths[level], spatial, add=last))
            last = b
        return last

    deepest = len(widths) - 1
    for level, count in enumerate(blocks):
        if level:
            skips.append(last)
            nodes.append(conv(f"down{level}", last, widths[level], spatial, stride=half, activation=LEAKY))
            last = f"down{level}"
        last = residual(last, level, range(1, (count if level == deepest else count // 2) + 1))
    for level in reversed(range(deepest)):
        nodes.append(conv(f"up{level}", last, widths[level], half, stride=half, transpose=True, add=skips.pop()))
        last = residual(f"up{level}", level, range(blocks[level] // 2 + 1, blocks[level] + 1))
    if deepest:
        nodes.append(conv("fine", last, widths[0], spatial, activation=LEAKY))
        last = "fine"
    nodes.append(conv("tail", last, fold[0] * fold[1] * (len(taps) + 1), (1, 1, 1)))
    inputs = ["tail", "log_irradiance", "estimate"]
    nodes.append({"name": "radiance", "op": "blend", "inputs": inputs, "block": [1, *fold], "taps": taps})
    graph = {"version": 1, "name": name, "pattern": pattern, "nodes": nodes, "output": "radiance"}
    return {**graph, "window": window_around(graph, hop)}


def window_around(graph: dict, hop: int) -> dict:
    """The window whose lead is what the net reaches in time."""
    far = 8 * hop
    first, _ = needed_frames({**graph, "window": {"frames": 2 * far + hop, "lead": far, "hop": hop}})["measurement"]
    return {"frames": hop + 2 * (far - first), "lead": far - first, "hop": hop}


def paper(
    widths=(32, 64, 128),
    residual_blocks=12,
    hdr_width=32,
    *,
    name="paper",
    channels=("measurement",),
    window=(8, 2, 4),
    exposures=(2, 4, 8),
    weight_floor=1e-3,
):
    """The paper's LDR-net, inverse response, HDR-net and fusion, with design §4's settlements.

    Where the text is silent: every encoder convolution is followed by LeakyReLU and norm, the transposed
    convolutions by neither (the paper puts them behind the 3×3×3 convolution); a residual module is convolution →
    LeakyReLU → norm → convolution, plus the skip. The fusion weights leave the fifth module through a 1×1×1
    convolution with softplus plus a floor: it is linear behind a linear layer, so it adds nothing but the
    activation that keeps the denominator of eq. 23 positive.
    """
    c1, c2, c3 = widths
    k3, k4, two = (3, 3, 3), (4, 4, 4), (2, 2, 2)

    def active(*args, **more):
        return conv(*args, activation=LEAKY, norm=True, **more)

    nodes = [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
        {
            "name": "input",
            "op": "features",
            "inputs": ["measurement", "estimate"],
            "channels": list(channels),
            "block": [1, 1, 1],
        },
        active("encoder1", "input", c1, (7, 7, 7)),
        active("encoder2a", "encoder1", c2, k3),
        active("encoder2b", "encoder2a", c2, k3, stride=two),
        active("encoder3a", "encoder2b", c3, k3),
        active("encoder3b", "encoder3a", c3, k3, stride=two),
    ]
    last = "encoder3b"
    for i in range(1, residual_blocks + 1):
        nodes.append(active(f"bottleneck{i}a", last, c3, k3))
        nodes.append(conv(f"bottleneck{i}b", f"bottleneck{i}a", c3, k3, add=last))
        last = f"bottleneck{i}b"
    nodes += [
        {"name": "skip3", "op": "concat", "inputs": ["encoder3b", last]},
        conv("decoder1up", "skip3", c2, k4, stride=two, transpose=True),
        active("decoder1", "decoder1up", c2, k3),
        {"name": "skip2", "op": "concat", "inputs": ["encoder2b", "decoder1"]},
        conv("decoder2up", "skip2", c1, k4, stride=two, transpose=True),
        active("decoder2", "decoder2up", c1, k3),
        {"name": "skip1", "op": "concat", "inputs": ["encoder1", "decoder2"]},
        conv("decoder3up", "skip1", c1, k3, transpose=True),
        conv("ldr", "decoder3up", len(exposures), k3, activation="sigmoid"),
        {"name": "irradiance", "op": "inverse_response", "inputs": ["ldr"], "exposures": list(exposures)},
    ]
    last, n = "irradiance", len(exposures)
    for i in range(1, 6):
        skip = last
        channels = n if i == 5 else hdr_width
        if i in (1, 5):
            skip = f"hdr{i}skip"
            nodes.append(conv(skip, last, channels, (1, 1, 1)))
        nodes.append(active(f"hdr{i}a", last, hdr_width, k3))
        nodes.append(conv(f"hdr{i}b", f"hdr{i}a", channels, k3, add=skip))
        last = f"hdr{i}b"
    nodes += [
        conv("weights", last, n, (1, 1, 1), activation={"softplus": weight_floor}),
        {"name": "radiance", "op": "fuse", "inputs": ["weights", "irradiance"]},
    ]
    return {
        "version": 1,
        "name": name,
        "pattern": "mpve-1-4",
        "window": dict(zip(("frames", "lead", "hop"), window, strict=True)),
        "nodes": nodes,
        "output": "radiance",
    }


# The paper's net in a form that two cores can train: half as wide, windows that repeat less work, and the box filter among
# its inputs, to start from (start.py).
NARROW = {
    "widths": (16, 32, 64),
    "hdr_width": 16,
    "channels": ("measurement", "log_irradiance", "log_estimate", "log_exposure"),
    "window": (24, 4, 16),
}
FAST = {"widths": (32, 64, 96), "blocks": (0, 4, 2), "reach": 3, "hop": 96}

PRESETS = {
    "tiny": lambda: kernel_net((16, 32), (0, 2), name="tiny"),
    "fast": lambda: kernel_net(**FAST, name="fast"),
    "fast-1-8": lambda: kernel_net(**FAST, name="fast-1-8", pattern="mpve-1-8", period=16),
    "fast-1-16": lambda: kernel_net(**FAST, name="fast-1-16", pattern="mpve-1-16", period=32),
    "robust": lambda: kernel_net(**FAST, name="robust"),
    "large": lambda: kernel_net(**{**FAST, "widths": (64, 128, 192)}, name="large"),
    "paper": lambda: paper(),
    "paper-narrow": lambda: paper(**NARROW, name="paper-narrow"),
}


def to_json(graph: dict) -> str:
    """The graph as JSON, one node a line."""
    head = {key: graph[key] for key in ("version", "name", "pattern", "window")}
    lines = [f"  {json.dumps(key)}: {json.dumps(value)}," for key, value in head.items()]
    nodes = ",\n".join("    " + json.dumps(node) for node in graph["nodes"])
    return "{\n" + "\n".join(lines) + '\n  "nodes": [\n' + nodes + f'\n  ],\n  "output": {json.dumps(graph["output"])}\n}}\n'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder to write NAME.json into")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    print(f"{'preset':14} {'GFLOP/frame 128×128':>20} {'values':>10} {'granularity':>12}")
    for name, build in PRESETS.items():
        graph = build()
        (out / f"{name}.json").write_text(to_json(graph))
        rows, columns = granularity(graph)
        print(f"{name:14} {gflop_per_frame(graph):20.3f} {parameter_count(graph):10} {rows:9}×{columns}")


if __name__ == "__main__":
    main()
