"""The built-in layer graphs, and `python -m pix2hdr_training.presets`, which writes them as JSON."""

import argparse
import json
from pathlib import Path

from .layout import gflop_per_frame, granularity, needed_frames, parameter_count

LEAKY = {"leaky_relu": 0.2}
CUBE = (3, 3, 3)
KERNEL_CHANNELS = ("log_irradiance", "log_estimate", "saturated")


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
    channels=KERNEL_CHANNELS,
):
    """One net that predicts kernels: for each pixel weights over log irradiances around it, and a residual.

    A U-net on the pattern's folded tile. `widths` are those of its levels, each half as wide and high as the one before;
    `blocks` are the residual blocks of each level, half of them on the way down and half on the way up. A block is a
    convolution over three frames and one over 3×3 pixels. The taps are the pixels of the same frame that are at most
    `reach` away, and the same pixel half a period, a period and two frames before and after. The window's lead is all
    that the net reaches in time, so a result does not depend on where windows begin: `hop` can be as long as memory
    and latency allow.
    """
    steps = neighbours(period)
    taps = taps_around(reach, steps)
    nodes = [*inputs_on_tiles("features", channels, steps, fold), *u_net("features", widths, blocks)]
    nodes += blended("radiance", nodes[-1]["name"], "estimate", fold, taps)
    graph = {"version": 1, "name": name, "pattern": pattern, "nodes": nodes, "output": "radiance"}
    return {**graph, "window": window_around(graph, hop)}


def u_net(source: str, widths, blocks) -> list[dict]:
    """The convolutions of `kernel_net`, from a folded tile to features of the same size."""
    half, spatial = (1, 2, 2), (1, 3, 3)
    nodes = [conv("entry", source, widths[0], spatial, activation=LEAKY)]
    skips = []

    def residual(level: int, indices) -> None:
        for i in indices:
            nodes.extend(residual_block(f"level{level}block{i}", nodes[-1]["name"], widths[level]))

    deepest = len(widths) - 1
    for level, count in enumerate(blocks):
        if level:
            skips.append(nodes[-1]["name"])
            nodes.append(conv(f"down{level}", skips[-1], widths[level], spatial, stride=half, activation=LEAKY))
        residual(level, range(1, (count if level == deepest else count // 2) + 1))
    for level in reversed(range(deepest)):
        last, skip = nodes[-1]["name"], skips.pop()
        nodes.append(conv(f"up{level}", last, widths[level], half, stride=half, transpose=True, add=skip))
        residual(level, range(blocks[level] // 2 + 1, blocks[level] + 1))
    if deepest:
        nodes.append(conv("fine", nodes[-1]["name"], widths[0], spatial, activation=LEAKY))
    return nodes


def residual_block(name: str, source: str, channels: int) -> list[dict]:
    """A convolution over three frames and one over 3×3 pixels, plus the source."""
    return [
        conv(f"{name}a", source, channels, (3, 1, 1), activation=LEAKY),
        conv(f"{name}b", f"{name}a", channels, (1, 3, 3), add=source),
    ]


def blended(name: str, features: str, estimate: str, fold, taps) -> list[dict]:
    """The kernels `tail` of each pixel from features on the folded tile, and the `blend` that applies them."""
    inputs = ["tail", "log_irradiance", estimate]
    return [
        conv("tail", features, fold[0] * fold[1] * (len(taps) + 1), (1, 1, 1)),
        {"name": name, "op": "blend", "inputs": inputs, "block": [1, *fold], "taps": taps},
    ]


def neighbours(period: int) -> list[int]:
    """Frames of the same pixel half a period and a period before and after."""
    return [-period, -period // 2, period // 2, period]


def taps_around(reach: int, steps: list[int]) -> list[list[int]]:
    """Offsets (t, y, x) of a kernel: pixels at most `reach` away, the same pixel `steps` and two frames before and after."""
    near = range(-reach, reach + 1)
    return [[0, dy, dx] for dy in near for dx in near] + [[dt, 0, 0] for dt in sorted({*steps, -2, 2})]


def inputs_on_tiles(name: str, channels, steps: list[int], fold) -> list[dict]:
    """Box estimate, log irradiance, and the features `name` of both on the folded tile, with neighbours in time."""
    return [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
        {"name": "log_irradiance", "op": "log_irradiance", "inputs": ["measurement"]},
        {
            "name": name,
            "op": "features",
            "inputs": ["measurement", "estimate", "log_irradiance"],
            "channels": list(channels),
            "neighbours": steps,
            "block": [1, *fold],
        },
    ]


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
    n, (c1, c2, c3) = len(exposures), widths
    k4, two = (4, 4, 4), (2, 2, 2)
    blocks = [f"bottleneck{i}" for i in range(1, residual_blocks + 1)]
    before = ["encoder3b", *(f"{block}b" for block in blocks)]
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
        active("encoder2a", "encoder1", c2, CUBE),
        active("encoder2b", "encoder2a", c2, CUBE, stride=two),
        active("encoder3a", "encoder2b", c3, CUBE),
        active("encoder3b", "encoder3a", c3, CUBE, stride=two),
        *(node for block, source in zip(blocks, before, strict=False) for node in residual_module(block, source, c3)),
        {"name": "skip3", "op": "concat", "inputs": ["encoder3b", before[-1]]},
        conv("decoder1up", "skip3", c2, k4, stride=two, transpose=True),
        active("decoder1", "decoder1up", c2, CUBE),
        {"name": "skip2", "op": "concat", "inputs": ["encoder2b", "decoder1"]},
        conv("decoder2up", "skip2", c1, k4, stride=two, transpose=True),
        active("decoder2", "decoder2up", c1, CUBE),
        {"name": "skip1", "op": "concat", "inputs": ["encoder1", "decoder2"]},
        conv("decoder3up", "skip1", c1, CUBE, transpose=True),
        conv("ldr", "decoder3up", n, CUBE, activation="sigmoid"),
        {"name": "irradiance", "op": "inverse_response", "inputs": ["ldr"], "exposures": list(exposures)},
        conv("hdr1skip", "irradiance", hdr_width, (1, 1, 1)),
        active("hdr1a", "irradiance", hdr_width, CUBE),
        conv("hdr1b", "hdr1a", hdr_width, CUBE, add="hdr1skip"),
        *(node for i in (2, 3, 4) for node in residual_module(f"hdr{i}", f"hdr{i - 1}b", hdr_width)),
        conv("hdr5skip", "hdr4b", n, (1, 1, 1)),
        active("hdr5a", "hdr4b", hdr_width, CUBE),
        conv("hdr5b", "hdr5a", n, CUBE, add="hdr5skip"),
        conv("weights", "hdr5b", n, (1, 1, 1), activation={"softplus": weight_floor}),
        {"name": "radiance", "op": "fuse", "inputs": ["weights", "irradiance"]},
    ]
    window = dict(zip(("frames", "lead", "hop"), window, strict=True))
    return {"version": 1, "name": name, "pattern": "mpve-1-4", "window": window, "nodes": nodes, "output": "radiance"}


def paper_on_tiles(
    widths=(64, 128, 192),
    blocks=(0, 4, 2),
    hdr_width=64,
    *,
    name="paper-narrow",
    fold=(2, 4),
    period=8,
    hop=96,
    reach=3,
    exposures=(0.5, 2, 8),
    weight_floor=1e-3,
):
    """The paper's chain on the pattern's folded tile: LDR-net, inverse response, HDR-net, fusion; then kernels.

    LDR-net is the U-net of `kernel_net`, layer for layer, so it can start as a trained one. It renders its videos through a
    transposed convolution of the tile's size, which sees the features too: there the videos begin as the box estimate
    (start.py). HDR-net goes back to tiles with the stride of its first layer; the first skip brings LDR-net's features,
    which know the noise. Its weights leave as LDR-net's videos do. Behind fusion, both nets' features give kernels as
    `kernel_net`'s do, relative to what was fused. The lowest exposure is below the camera's, so that the sigmoid's soft end
    is not reached.
    """
    tile, n = (1, *fold), len(exposures)
    steps = neighbours(period)
    onto_tiles = (1, fold[0] | 1, fold[1] | 1)  # the smallest kernel that sees all of a tile
    nodes = [
        *inputs_on_tiles("features", KERNEL_CHANNELS, steps, fold),
        *u_net("features", widths, blocks),
        {"name": "skip", "op": "concat", "inputs": ["fine", "features"]},
        conv("ldr", "skip", n, tile, stride=tile, transpose=True, activation="sigmoid"),
        {"name": "irradiance", "op": "inverse_response", "inputs": ["ldr"], "exposures": list(exposures)},
        conv("hdr1skip", "fine", hdr_width, (1, 1, 1)),
        conv("hdr1a", "irradiance", hdr_width, onto_tiles, stride=tile, activation=LEAKY),
        conv("hdr1b", "hdr1a", hdr_width, (1, 3, 3), add="hdr1skip"),
        *(node for i in (2, 3, 4, 5) for node in residual_block(f"hdr{i}", f"hdr{i - 1}b", hdr_width)),
        conv("weights", "hdr5b", n, tile, stride=tile, transpose=True, activation={"softplus": weight_floor}),
        {"name": "fused", "op": "fuse", "inputs": ["weights", "irradiance"]},
        {"name": "both", "op": "concat", "inputs": ["fine", "hdr5b"]},
        *blended("radiance", "both", "fused", fold, taps_around(reach, steps)),
    ]
    graph = {"version": 1, "name": name, "pattern": "mpve-1-4", "nodes": nodes, "output": "radiance"}
    return {**graph, "window": window_around(graph, hop)}


def active(name, source, channels, kernel, **more) -> dict:
    """A convolution with LeakyReLU and norm, as in the paper's text."""
    return conv(name, source, channels, kernel, activation=LEAKY, norm=True, **more)


def residual_module(name: str, source: str, channels: int) -> list[dict]:
    """The paper's residual module without a projection."""
    return [active(f"{name}a", source, channels, CUBE), conv(f"{name}b", f"{name}a", channels, CUBE, add=source)]


FAST = {"widths": (32, 64, 96), "blocks": (0, 4, 2), "reach": 3, "hop": 96}

PRESETS = {
    "tiny": lambda: kernel_net((16, 32), (0, 2), name="tiny"),
    "fast": lambda: kernel_net(**FAST, name="fast"),
    "fast-1-8": lambda: kernel_net(**FAST, name="fast-1-8", pattern="mpve-1-8", period=16),
    "fast-1-16": lambda: kernel_net(**FAST, name="fast-1-16", pattern="mpve-1-16", period=32),
    "robust": lambda: kernel_net(**FAST, name="robust"),
    "large": lambda: kernel_net(**{**FAST, "widths": (64, 128, 192)}, name="large"),
    "paper": lambda: paper(),
    "paper-narrow": lambda: paper_on_tiles(),
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
