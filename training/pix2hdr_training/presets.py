"""The built-in layer graphs, and `python -m pix2hdr_training.presets`, which writes them as JSON."""

import argparse
import json
from pathlib import Path

from .layout import gflop_per_frame, granularity, parameter_count

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


def fast(
    width=96,
    blocks=4,
    *,
    name="fast",
    pattern="mpve-1-4",
    window=(16, 4, 8),
    fold=(2, 4),
    channels=("log_irradiance", "log_estimate"),
    entry_kernel=(1, 1, 1),
):
    """One net in the tone curve's domain: a residual over the box estimate, all of a window's time in channels.

    `window` is (frames, lead, hop), `fold` the rows and columns that are folded into channels. The net has
    2 + 2·`blocks` convolutions of [1, 3, 3] behind the entry.
    """
    frames, lead, hop = window
    k = (1, 3, 3)
    nodes = [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
        {
            "name": "features",
            "op": "features",
            "inputs": ["measurement", "estimate"],
            "channels": list(channels),
            "block": [frames, *fold],
        },
        conv("entry", "features", width, entry_kernel, activation=LEAKY),
        conv("head", "entry", width, k, activation=LEAKY),
    ]
    last = "head"
    for i in range(1, blocks + 1):
        nodes.append(conv(f"block{i}a", last, width, k, activation=LEAKY))
        nodes.append(conv(f"block{i}b", f"block{i}a", width, k, add=last))
        last = f"block{i}b"
    nodes.append(conv("tail", last, hop * fold[0] * fold[1], k))
    nodes.append({"name": "radiance", "op": "unfold", "inputs": ["tail", "estimate"], "block": [hop, *fold], "start": lead})
    return {
        "version": 1,
        "name": name,
        "pattern": pattern,
        "window": {"frames": frames, "lead": lead, "hop": hop},
        "nodes": nodes,
        "output": "radiance",
    }


def paper(widths=(32, 64, 128), residual_blocks=12, hdr_width=32, *, name="paper", exposures=(2, 4, 8), weight_floor=1e-3):
    """The paper's LDR-net, inverse response, HDR-net and fusion, with DESIGN §4's settlements.

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
            "channels": ["measurement"],
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
        "window": {"frames": 8, "lead": 2, "hop": 4},
        "nodes": nodes,
        "output": "radiance",
    }


PRESETS = {
    "fast": lambda: fast(),
    "medium": lambda: fast(64, 4, name="medium"),
    "tiny": lambda: fast(48, 3, name="tiny"),
    "paper": lambda: paper(),
    "paper-narrow": lambda: paper((16, 32, 64), 12, 16, name="paper-narrow"),
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
