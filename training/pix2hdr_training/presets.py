"""The built-in layer graphs, and `python -m pix2hdr_training.presets`, which writes them as JSON."""

import argparse
import json
from pathlib import Path

from .layout import gflop_per_frame, granularity, needed_frames, parameter_count

LEAKY = {"leaky_relu": 0.2}
CUBE = (3, 3, 3)


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
    steps = neighbours(period)
    taps = taps_around(reach, steps)
    half, spatial = (1, 2, 2), (1, 3, 3)
    nodes = [
        *inputs_on_tiles("features", channels, steps, fold),
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
    n = len(exposures)
    nodes = [
        {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
        {
            "name": "input",
            "op": "features",
            "inputs": ["measurement", "estimate"],
            "channels": ["measurement"],
            "block": [1, 1, 1],
        },
        active("encoder1", "input", widths[0], (7, 7, 7)),
        active("encoder2a", "encoder1", widths[1], CUBE),
        *paper_bottom(widths, residual_blocks, widths[0]),
        conv("decoder3up", "skip1", widths[0], CUBE, transpose=True),
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
    return paper_graph(name, window, nodes)


def paper_on_tiles(
    widths=(64, 48, 64),
    residual_blocks=6,
    hdr_width=32,
    *,
    name="paper-narrow",
    fold=(2, 4),
    window=(40, 8, 24),
    period=8,
    exposures=(0.5, 2, 8),
    reach=2,
    weight_floor=1e-3,
):
    """The paper's nets on the pattern's folded tile, with kernels over what was measured.

    LDR-net sees a tile as one place with many channels and leaves through a transposed convolution of the tile's size;
    HDR-net goes back to tiles with the stride of its first layer, and its weights leave as LDR-net's videos do. Beside
    videos at three exposures, LDR-net renders one for each of the 3×3 pixels around and for each of the same pixel half a
    period and a period before and after, all at the lowest exposure: they begin as what was measured there (start.py), so
    fusion weighs measurements too. The lowest exposure is below the camera's, so that the sigmoid's soft end is not reached.
    Behind fusion, HDR-net predicts a kernel as `kernel_net` does, for weights below zero.
    """
    c1, c2, _ = widths
    tile, spatial = (1, *fold), (1, 3, 3)
    steps = neighbours(period)
    taps = taps_around(reach, steps)
    videos = [*exposures, *[exposures[0]] * (3 * 3 + len(steps))]
    n, onto_tiles = len(videos), (3, fold[0] | 1, fold[1] | 1)  # the smallest kernel that sees all of a tile
    decoder_width = c1 // 2
    nodes = [
        *inputs_on_tiles("input", ("log_irradiance", "log_estimate", "saturated", "measurement"), steps, fold),
        active("encoder1", "input", c1, CUBE),
        active("encoder2a", "encoder1", c2, spatial),
        *paper_bottom(widths, residual_blocks, decoder_width),
        conv("decoder3up", "skip1", c1, spatial, transpose=True),
        conv("ldr", "decoder3up", n, tile, stride=tile, transpose=True, activation="sigmoid"),
        {"name": "irradiance", "op": "inverse_response", "inputs": ["ldr"], "exposures": videos},
        conv("hdr1skip", "irradiance", hdr_width, (1, *onto_tiles[1:]), stride=tile),
        active("hdr1a", "irradiance", hdr_width, onto_tiles, stride=tile),
        conv("hdr1b", "hdr1a", hdr_width, CUBE, add="hdr1skip"),
        *(node for i in (2, 3, 4, 5) for node in residual_module(f"hdr{i}", f"hdr{i - 1}b", hdr_width)),
        conv("weights", "hdr5b", n, tile, stride=tile, transpose=True, activation={"softplus": weight_floor}),
        {"name": "fused", "op": "fuse", "inputs": ["weights", "irradiance"]},
        conv("tail", "hdr5b", fold[0] * fold[1] * (len(taps) + 1), (1, 1, 1)),
        {"name": "radiance", "op": "blend", "inputs": ["tail", "log_irradiance", "fused"], "block": list(tile), "taps": taps},
    ]
    return paper_graph(name, window, nodes)


def paper_bottom(widths, residual_blocks: int, decoder_width: int) -> list[dict]:
    """LDR-net from the end of its second encoder block, below full resolution, to the last skip connection."""
    c1, c2, c3 = widths
    k4, two = (4, 4, 4), (2, 2, 2)
    blocks = [f"bottleneck{i}" for i in range(1, residual_blocks + 1)]
    before = ["encoder3b", *(f"{block}b" for block in blocks)]
    return [
        active("encoder2b", "encoder2a", c2, CUBE, stride=two),
        active("encoder3a", "encoder2b", c3, CUBE),
        active("encoder3b", "encoder3a", c3, CUBE, stride=two),
        *(node for block, source in zip(blocks, before, strict=False) for node in residual_module(block, source, c3)),
        {"name": "skip3", "op": "concat", "inputs": ["encoder3b", before[-1]]},
        conv("decoder1up", "skip3", c2, k4, stride=two, transpose=True),
        active("decoder1", "decoder1up", c2, CUBE),
        {"name": "skip2", "op": "concat", "inputs": ["encoder2b", "decoder1"]},
        conv("decoder2up", "skip2", decoder_width, k4, stride=two, transpose=True),
        active("decoder2", "decoder2up", decoder_width, CUBE),
        {"name": "skip1", "op": "concat", "inputs": ["encoder1", "decoder2"]},
    ]


def active(name, source, channels, kernel, **more) -> dict:
    """A convolution with LeakyReLU and norm, as in the paper's text."""
    return conv(name, source, channels, kernel, activation=LEAKY, norm=True, **more)


def residual_module(name: str, source: str, channels: int) -> list[dict]:
    """The paper's residual module without a projection."""
    return [active(f"{name}a", source, channels, CUBE), conv(f"{name}b", f"{name}a", channels, CUBE, add=source)]


def paper_graph(name: str, window, nodes: list[dict]) -> dict:
    """The graph of these nodes for `mpve-1-4`; `window` is (frames, lead, hop)."""
    window = dict(zip(("frames", "lead", "hop"), window, strict=True))
    return {"version": 1, "name": name, "pattern": "mpve-1-4", "window": window, "nodes": nodes, "output": "radiance"}


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
