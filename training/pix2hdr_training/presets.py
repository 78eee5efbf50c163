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
    width=32,
    temporal=(3, 1, 3, 1, 3, 3),
    *,
    name="fast",
    pattern="mpve-1-4",
    hop=40,
    fold=(2, 4),
    channels=("log_irradiance", "log_estimate", "saturated"),
):
    """One net in the tone curve's domain: a residual over the box estimate, the pattern's tile in channels.

    `temporal` is the extent in frames of each convolution: entry, pairs of a residual block, tail; in space all are
    3×3. The window's lead is what they reach in time, so a result does not depend on where windows begin: `hop` can
    be as long as memory and latency allow.
    """
    entry, *inner, tail = temporal
    lead = sum(t // 2 for t in temporal)
    window = {"frames": hop + 2 * lead, "lead": lead, "hop": hop}
    nodes = [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
        {
            "name": "features",
            "op": "features",
            "inputs": ["measurement", "estimate"],
            "channels": list(channels),
            "block": [1, *fold],
        },
        conv("entry", "features", width, (entry, 3, 3), activation=LEAKY),
    ]
    last = "entry"
    for i in range(0, len(inner), 2):
        a, b = f"block{i // 2 + 1}a", f"block{i // 2 + 1}b"
        nodes.append(conv(a, last, width, (inner[i], 3, 3), activation=LEAKY))
        nodes.append(conv(b, a, width, (inner[i + 1], 3, 3), add=last))
        last = b
    nodes.append(conv("tail", last, fold[0] * fold[1], (tail, 3, 3)))
    nodes.append({"name": "radiance", "op": "unfold", "inputs": ["tail", "estimate"], "block": [1, *fold], "start": 0})
    return {
        "version": 1,
        "name": name,
        "pattern": pattern,
        "window": window,
        "nodes": nodes,
        "output": "radiance",
    }


def paper(widths=(32, 64, 128), residual_blocks=12, hdr_width=32, *, name="paper", exposures=(2, 4, 8), weight_floor=1e-3):
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
    "medium": lambda: fast(24, (3, 1, 3, 3), name="medium"),
    "tiny": lambda: fast(16, (3, 1, 3, 1), name="tiny"),
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
