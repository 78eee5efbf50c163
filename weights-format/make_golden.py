"""Writes the golden files: what real PyTorch computes, in float64, for every operation and for small whole nets.

    python weights-format/make_golden.py [--out weights-format/golden]

Each case is a pair. `NAME.safetensors` is a valid weights file of a small graph, whose output may be any node.
`NAME.io.safetensors` holds the tensors `measurement` [t, y, x] and `output` [t, y, x, c], F32 — the output node
of one window, the result's frames alone if it spans the window — and the metadata (strings): `format` (`pix2hdr-golden/1`), `schedule_time` (of the
window's first frame), `period`, `rows`, `cols` and `exposures` (JSON list, row-major: the exposure of the read-out
that covers a frame) and `inverse_response` (JSON list: R⁻¹, uniform in y over [0, 1], linearly interpolated, ends
repeated outside).
"""

import argparse
import json
import sys
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "training"))

from pix2hdr_training import presets  # noqa: E402
from pix2hdr_training.export import canonical, net_from_weights, write_atomically, write_weights  # noqa: E402
from pix2hdr_training.graph import GraphNet  # noqa: E402
from pix2hdr_training.layout import granularity, shapes  # noqa: E402
from pix2hdr_training.operations import FEATURE_CHANNELS  # noqa: E402
from pix2hdr_training.pattern import ExposureTable, exposure_table  # noqa: E402
from pix2hdr_training.presets import conv  # noqa: E402
from pix2hdr_training.response import InverseResponse  # noqa: E402

LEAKY = {"leaky_relu": 0.2}
ESTIMATE = {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]}


@dataclass
class Case:
    """A graph and the size and circumstances of one window for it."""

    name: str
    graph: dict
    height: int
    width: int
    table: ExposureTable = field(default_factory=lambda: exposure_table("mpve-1-4"))
    curved: bool = False  # a non-linear response
    half: bool = False  # weights in F16
    gain: float = 1.0  # scales all weights and biases


def graph_of(name: str, nodes: list[dict], frames: int, pattern: str = "mpve-1-4") -> dict:
    """A graph whose output is the last node; the window is laid around that node's frames."""
    graph = {
        "version": 1,
        "name": name,
        "pattern": pattern,
        "window": {"frames": frames, "lead": 0, "hop": frames},
        "nodes": nodes,
        "output": nodes[-1]["name"],
    }
    # The number of result frames follows from the shapes.
    last = dict(graph, output="measurement")
    out = shapes(last, *granularity(graph))[graph["output"]].t
    if out < frames:
        graph["window"] = {"frames": frames, "lead": (frames - out) // 2, "hop": out}
    return graph


def features(channels=("log_irradiance",), block=(1, 1, 1), neighbours=()) -> list[dict]:
    """`estimate` and `features`, with `log_irradiance` between them if there are neighbours."""
    inputs = ["measurement", "estimate"]
    node = {"name": "features", "op": "features", "inputs": inputs, "channels": list(channels), "block": list(block)}
    if not neighbours:
        return [ESTIMATE, node]
    inputs.append("log_irradiance")
    node["neighbours"] = list(neighbours)
    return [ESTIMATE, {"name": "log_irradiance", "op": "log_irradiance", "inputs": ["measurement"]}, node]


def convolution_cases() -> list[Case]:
    """One `conv3d` or `conv_transpose3d` each, behind features of several channels."""
    cases = []

    def case(name, frames, height, width, source, *args, block=(1, 1, 1), extra=(), **more):
        nodes = [*features(source, block), *extra]
        nodes.append(conv("y", nodes[-1]["name"], *args, **more))
        cases.append(Case(name, graph_of(name, nodes, frames), height, width))

    five, three, one = FEATURE_CHANNELS, FEATURE_CHANNELS[:3], FEATURE_CHANNELS[:1]
    case("conv_k1", 3, 5, 7, five, 3, (1, 1, 1))
    case("conv_k3", 5, 7, 11, five, 7, (3, 3, 3))
    case("conv_k7", 5, 7, 11, one, 3, (7, 7, 7))
    case("conv_k133", 3, 7, 5, three, 6, (1, 3, 3))
    case("conv_k311", 5, 3, 5, three, 5, (3, 1, 1))
    case("conv_k153", 2, 5, 7, three, 4, (1, 5, 3))
    case("conv_single_pixel", 1, 1, 1, three, 5, (3, 3, 3))
    case("conv_k3_s122", 3, 6, 10, three, 6, (3, 3, 3), stride=(1, 2, 2))
    case("conv_k133_s122", 3, 10, 6, three, 5, (1, 3, 3), stride=(1, 2, 2))
    case("conv_k3_s222", 5, 6, 10, three, 8, (3, 3, 3), stride=(2, 2, 2))
    case("conv_k7_s211", 5, 5, 3, one, 2, (7, 7, 7), stride=(2, 1, 1))
    case("conv_one_frame_many_channels", 4, 10, 14, three, 37, (1, 3, 3), block=(4, 2, 2))
    case("conv_many_channels", 4, 6, 10, three, 17, (3, 3, 3), block=(2, 2, 2))
    case("conv_c16_to_c32", 4, 10, 14, FEATURE_CHANNELS[:1], 32, (1, 3, 3), block=(4, 2, 2), activation=LEAKY)
    case("conv_sigmoid", 3, 5, 7, five, 3, (3, 3, 3), activation="sigmoid")
    case("conv_leaky_relu", 3, 5, 7, five, 6, (3, 3, 3), activation=LEAKY)
    case("conv_leaky_relu_small", 3, 5, 7, five, 5, (1, 3, 3), activation={"leaky_relu": 0.01})
    case("conv_relu", 3, 5, 7, five, 5, (1, 1, 1), activation={"leaky_relu": 0.0})
    case("conv_softplus", 3, 5, 7, five, 3, (3, 3, 3), activation={"softplus": 1e-3})
    case("conv_norm", 3, 5, 7, five, 6, (3, 3, 3), activation=LEAKY, norm=True)
    case("conv_add", 3, 5, 7, five, 5, (3, 3, 3), add="features")
    case("conv_epilogue", 3, 5, 7, five, 5, (1, 3, 3), activation=LEAKY, norm=True, add="features")
    # Transposed convolutions stand behind a stride of 2, or their output would have more frames than the window.
    down = [conv("down", "features", 6, (3, 3, 3), stride=(2, 2, 2), activation=LEAKY)]
    down_flat = [conv("down", "features", 7, (1, 3, 3), stride=(1, 2, 2), activation=LEAKY)]
    case("transpose_k4_s2", 4, 6, 10, three, 5, (4, 4, 4), stride=(2, 2, 2), transpose=True, extra=down)
    case("transpose_k144_s122", 3, 10, 6, three, 4, (1, 4, 4), stride=(1, 2, 2), transpose=True, extra=down_flat)
    case("transpose_k344_s122", 3, 6, 14, three, 3, (3, 4, 4), stride=(1, 2, 2), transpose=True, extra=down_flat)
    case("transpose_k2_s2", 2, 6, 10, three, 4, (2, 2, 2), stride=(2, 2, 2), transpose=True, extra=down)
    case("transpose_k3_s1", 3, 5, 7, five, 6, (3, 3, 3), transpose=True)
    case("transpose_k1_s1", 3, 5, 7, five, 3, (1, 1, 1), transpose=True, activation="sigmoid")
    case(
        "transpose_epilogue", 4, 6, 10, five, 5, (4, 4, 4), stride=(2, 2, 2), transpose=True, extra=down,
        activation=LEAKY, norm=True, add="features",
    )  # fmt: skip
    return cases


def time_varying_table() -> ExposureTable:
    """A made-up pattern whose exposures change with time, as whole-frame interleaving does."""
    rng = np.random.default_rng(5)
    return ExposureTable(rng.choice([1.0, 2.0, 3.0], (5, 3, 2)))


def other_cases() -> list[Case]:
    """The operations that are no convolutions."""
    cases = []

    def case(name, nodes, frames, height, width, pattern="mpve-1-4", **more):
        cases.append(Case(name, graph_of(name, nodes, frames, pattern), height, width, **more))

    varying = {"pattern": "interleaved", "table": time_varying_table()}
    case("box_estimate", [ESTIMATE], 3, 13, 17)
    case("box_estimate_curved", [ESTIMATE], 3, 7, 11, curved=True)
    case("box_estimate_one_row", [ESTIMATE], 2, 1, 7)
    case("box_estimate_one_column", [ESTIMATE], 2, 5, 1)
    case("box_estimate_one_pixel", [ESTIMATE], 1, 1, 1)
    case("box_estimate_two_rows", [ESTIMATE], 2, 2, 2)
    case("box_estimate_mpve_1_16", [ESTIMATE], 3, 5, 9, "mpve-1-16", table=exposure_table("mpve-1-16"))
    case("box_estimate_time_varying", [ESTIMATE], 7, 5, 7, **varying)
    case("features_all", features(FEATURE_CHANNELS), 3, 5, 7)
    case("features_measurement", features(["measurement"]), 2, 3, 5)
    case("features_fold", features(FEATURE_CHANNELS, (2, 2, 3)), 4, 6, 9)
    case("features_fold_order", features(["log_exposure", "measurement"], (3, 1, 2)), 6, 5, 6)
    case("features_curved", features(FEATURE_CHANNELS, (1, 2, 4)), 2, 4, 8, curved=True)
    case("features_time_varying", features(FEATURE_CHANNELS, (4, 1, 1)), 4, 5, 7, **varying)
    case(
        "concat",
        [
            *features(FEATURE_CHANNELS[:2], (1, 1, 2)),
            conv("a", "features", 8, (1, 3, 3), activation=LEAKY),
            conv("b", "a", 3, (3, 3, 3)),
            {"name": "y", "op": "concat", "inputs": ["features", "a", "b"]},
        ],
        3, 5, 14,
    )  # fmt: skip
    case(
        "concat_conv",
        [
            *features(FEATURE_CHANNELS[:2], (1, 1, 2)),
            conv("a", "features", 5, (1, 3, 3), activation=LEAKY),
            {"name": "both", "op": "concat", "inputs": ["features", "a"]},
            conv("y", "both", 6, (3, 3, 3)),
        ],
        3, 5, 14,
    )  # fmt: skip
    ldr = [*features(FEATURE_CHANNELS[:3]), conv("ldr", "features", 3, (3, 3, 3), activation="sigmoid")]
    inverse = {"name": "irradiance", "op": "inverse_response", "inputs": ["ldr"], "exposures": [2, 4, 8]}
    case("inverse_response", [*ldr, inverse], 3, 5, 7)
    case("inverse_response_curved", [*ldr, inverse], 3, 5, 7, curved=True)
    # Without the sigmoid y leaves [0, 1]: R⁻¹ holds its ends there.
    case(
        "inverse_response_outside",
        [*ldr[:-1], conv("ldr", "features", 3, (3, 3, 3)), inverse], 3, 5, 7, curved=True,
    )  # fmt: skip
    weights = conv("weights", "irradiance", 3, (1, 3, 3), activation={"softplus": 1e-3})
    fuse = {"name": "y", "op": "fuse", "inputs": ["weights", "irradiance"]}
    case("fuse", [*ldr, inverse, weights, fuse], 3, 5, 7)
    case("fuse_curved", [*ldr, inverse, weights, fuse], 3, 5, 7, curved=True, gain=2.0)
    near = features(FEATURE_CHANNELS, (1, 2, 4), neighbours=(-3, 1))
    case("log_irradiance", near[1:2], 3, 5, 7)
    case("features_neighbours", near, 4, 4, 8)
    case("features_neighbours_curved", near, 4, 4, 8, curved=True)
    taps = [[0, 0, 0], [0, -1, 2], [2, 1, 0], [-1, 0, -9]]
    for name, block, chosen, gain in (
        ("blend", (1, 2, 4), taps, 0.05),
        ("blend_pixels", (1, 1, 1), taps[:3], 0.05),
        ("blend_without_taps", (1, 3, 1), [], 0.05),
        ("blend_clamped", (1, 1, 2), taps, 2.0),
    ):
        tail = [
            *features(FEATURE_CHANNELS, block, neighbours=(-3, 1)),
            conv("tail", "features", block[1] * block[2] * (len(chosen) + 1), (1, 3, 3)),
            {
                "name": "y",
                "op": "blend",
                "inputs": ["tail", "log_irradiance", "estimate"],
                "block": list(block),
                "taps": chosen,
            },
        ]
        case(name, tail, 4, 5 * block[1], 3 * block[2], gain=gain)
    return cases


def net_cases() -> list[Case]:
    """Small whole nets of the presets' make."""
    narrow = presets.kernel_net((8, 12), (1, 2), name="fast_narrow", hop=8)
    wide = presets.kernel_net(
        (7,), (2,), name="fast_all_features", pattern="mpve-1-8", period=16, hop=4, fold=(2, 2), channels=FEATURE_CHANNELS
    )
    ldr_hdr = presets.paper((4, 8, 12), 2, 4, name="paper_narrow")
    on_tiles = presets.paper_on_tiles((8, 12), (1, 2), 8, name="paper_on_tiles", hop=4, reach=1)
    return [
        Case("net_fast", narrow, 12, 16, gain=0.6),
        Case("net_fast_f16", narrow, 12, 16, half=True, gain=0.6),
        Case("net_fast_curved", narrow, 4, 8, curved=True, gain=0.6),
        Case("net_fast_all_features", wide, 10, 14, table=exposure_table("mpve-1-8"), curved=True, gain=0.6),
        Case("net_paper", ldr_hdr, 12, 20),
        Case("net_paper_curved_f16", ldr_hdr, 8, 12, curved=True, half=True),
        Case("net_paper_on_tiles", on_tiles, 16, 16, curved=True, gain=0.4),
    ]


def cases() -> list[Case]:
    """All golden cases."""
    found = convolution_cases() + other_cases() + net_cases()
    names = [case.name for case in found]
    assert len(set(names)) == len(names), "two cases of one name"
    return found


def inverse_table(saturation: float, curved: bool) -> list[float]:
    """257 entries: a straight line, or a curve with R⁻¹' from 0.6 to 1.8 times it."""
    y = np.linspace(0.0, 1.0, 257)
    shape = 0.6 * y + 0.4 * y**3 if curved else y
    return [round(float(v), 7) for v in saturation * shape]


def measurement(rng, frames: int, height: int, width: int) -> np.ndarray:
    """Ten-bit pixel values: noise of all levels, black and saturated pixels, and one saturated patch."""
    levels = np.rint(1023 * rng.random((frames, height, width)) ** 2)
    levels[rng.random(levels.shape) < 0.15] = 1023
    levels[rng.random(levels.shape) < 0.05] = 0
    if height > 4 and width > 4:
        levels[:, :4, :4] = 1020
    return (levels / 1023).astype(np.float32)


def randomise(net: GraphNet, rng, gain: float) -> None:
    """Weights that keep the values' size, biases, and batch norms with a past."""
    with torch.no_grad():
        for layer in net.layers.values():
            fan_in = layer.weight[0].numel() if not layer.transposed else layer.weight.numel() / layer.weight.shape[1]
            if layer.transposed:
                fan_in /= float(np.prod(layer.stride))
            layer.weight.copy_(torch.from_numpy(rng.normal(0, gain * (1.5 / fan_in) ** 0.5, layer.weight.shape)))
            layer.bias.copy_(torch.from_numpy(rng.normal(0, 0.1 * gain, layer.bias.shape)))
            if layer.norm is not None:
                n = layer.bias.shape
                layer.norm.weight.copy_(torch.from_numpy(rng.uniform(0.5, 1.5, n)))
                layer.norm.bias.copy_(torch.from_numpy(rng.normal(0, 0.2, n)))
                layer.norm.running_mean.copy_(torch.from_numpy(rng.normal(0, 0.3, n)))
                layer.norm.running_var.copy_(torch.from_numpy(rng.uniform(0.3, 2.0, n)))


def write_case(case: Case, out: Path) -> None:
    """Writes the two files of a case."""
    rng = np.random.default_rng(zlib.crc32(case.name.encode()))
    window = case.graph["window"]
    table = inverse_table(case.table.saturation, case.curved)
    net = GraphNet(case.graph, InverseResponse(table)).double().eval()
    randomise(net, rng, case.gain)
    path = out / f"{case.name}.safetensors"
    write_weights(path, net, provenance={"golden": case.name}, half=case.half)
    y = measurement(rng, window["frames"], case.height, case.width)
    # Any start that puts the first result frame at a multiple of `hop`.
    schedule_time = (int(rng.integers(3, 7)) + window["lead"]) * window["hop"] - window["lead"]
    exposure = case.table.window(schedule_time, *y.shape)
    stored = net_from_weights(path, InverseResponse(table)).double()
    with torch.no_grad():
        output = stored(torch.from_numpy(y).double()[None], torch.from_numpy(exposure)[None])
    output = output[0].permute(1, 2, 3, 0).contiguous().numpy()
    assert np.all(np.isfinite(output)), case.name
    metadata = {
        "format": "pix2hdr-golden/1",
        "schedule_time": str(schedule_time),
        "period": str(case.table.period),
        "rows": str(case.table.tile[0]),
        "cols": str(case.table.tile[1]),
        "exposures": json.dumps(case.table.exposures.ravel().tolist()),
        "inverse_response": json.dumps(table),
    }
    tensors = {"measurement": y, "output": output.astype(np.float32)}
    write_atomically(out / f"{case.name}.io.safetensors", canonical(save(tensors, metadata)))


def main(arguments=None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent / "golden")
    out = parser.parse_args(arguments).out
    out.mkdir(parents=True, exist_ok=True)
    for old in out.glob("*.safetensors"):
        old.unlink()
    torch.set_num_threads(1)
    for case in cases():
        write_case(case, out)
    files = list(out.glob("*.safetensors"))
    print(f"{len(files) // 2} cases, {sum(f.stat().st_size for f in files) / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
