"""Operations of the graph module against slow, independent statements of the same thing."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from pix2hdr_training import layout, presets
from pix2hdr_training.graph import GraphNet
from pix2hdr_training.operations import Convolution, Frames, box_estimate, fold, unfold
from pix2hdr_training.pattern import exposure_table
from pix2hdr_training.response import InverseResponse
from pix2hdr_training.tone import inverse_tone, tone

FORMAT = Path(__file__).resolve().parents[2] / "weights-format"


def mirror(i, n):
    """−1 → 1, n → n − 2; a size of 1 repeats."""
    if n == 1:
        return 0
    return 1 if i < 0 else n - 2 if i >= n else i


def slow_box(y, e, saturation):
    out = np.zeros_like(y)
    frames, height, width = y.shape
    for t, r, c in np.ndindex(frames, height, width):
        total = weight = all_total = 0.0
        for dy, wy in zip((-1, 0, 1), (1, 2, 1), strict=True):
            for dx, wx in zip((-1, 0, 1), (1, 2, 1), strict=True):
                at = t, mirror(r + dy, height), mirror(c + dx, width)
                p = y[at] * saturation / e[at]
                all_total += wy * wx * p
                if y[at] < 0.98:
                    total, weight = total + wy * wx * p, weight + wy * wx
        out[t, r, c] = total / weight if weight else all_total / 16
    return out


@pytest.mark.parametrize("size", [(5, 7), (1, 4), (3, 1), (1, 1), (2, 2)])
def test_box_estimate_is_the_slow_loop(size):
    rng = np.random.default_rng(1)
    y = np.where(rng.random((2, *size)) < 0.5, 1.0, rng.random((2, *size)))
    e = exposure_table("mpve-1-4").window(3, 2, *size)
    inverse = InverseResponse.of_linear(2.0)
    fast = box_estimate(torch.from_numpy(y), torch.from_numpy(e), inverse).numpy()
    np.testing.assert_allclose(fast, slow_box(y, e, 2.0), rtol=1e-12)


def test_fold_and_unfold_have_the_order_of_the_format():
    x = torch.arange(2 * 4 * 6 * 8).reshape(2, 4, 6, 8).double()
    bt, by, bx = 2, 3, 4
    folded = fold([x, -x - 1], (bt, by, bx))
    assert folded.shape == (2, bt * by * bx * 2, 2, 2, 2)
    for dt, dy, dx, i in np.ndindex(bt, by, bx, 2):
        value = folded[1, ((dt * by + dy) * bx + dx) * 2 + i, 1, 0, 1]
        source = x[1, bt + dt, dy, bx + dx]
        assert value == (source if i == 0 else -source - 1)
    channels = torch.arange(2 * 12 * 3 * 2 * 2).reshape(2, 12, 3, 2, 2)
    unfolded = unfold(channels, (1, 2, 3))
    assert unfolded.shape == (2, 2, 3, 4, 6)
    for i, dy, dx in np.ndindex(2, 2, 3):
        assert torch.equal(unfolded[:, i, :, dy::2, dx::3], channels[:, (i * 2 + dy) * 3 + dx])


def test_inverse_response_interpolates_and_holds_its_ends():
    inverse = InverseResponse([0.0, 0.5, 2.0])
    y = torch.tensor([-1.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5], dtype=torch.float64)
    torch.testing.assert_close(inverse(y), torch.tensor([0, 0, 0.25, 0.5, 1.25, 2, 2], dtype=torch.float64))
    x = torch.linspace(0, 2, 41, dtype=torch.float64)
    torch.testing.assert_close(inverse(inverse.forward(x)), x)
    assert InverseResponse(np.linspace(0, 2, 9)).linear
    with pytest.raises(ValueError, match="increasing"):
        InverseResponse([0, 1, 0.5])


def test_tone_curve():
    p = torch.tensor([0.0, 0.18, 1.0], dtype=torch.float64)
    assert tone(p)[0] == 0 and tone(p)[2] == 1
    torch.testing.assert_close(inverse_tone(tone(p)), p)


def window_of(graph, height, width, seed=0):
    """y and e of one window, [1, frames, H, W]."""
    rng = np.random.default_rng(seed)
    frames = graph["window"]["frames"]
    y = np.rint(1023 * rng.random((1, frames, height, width))) / 1023
    e = exposure_table("mpve-1-4").window(4, frames, height, width)[None]
    return torch.from_numpy(y).float(), torch.from_numpy(e).float()


def test_a_zero_tail_is_the_box_estimate():
    graph = presets.kernel_net((8, 12), (1, 2), name="small", hop=8)
    net = GraphNet(graph, InverseResponse.of_linear(2.0)).eval()
    with torch.no_grad():
        net.layers["tail"].weight.zero_()
        y, e = window_of(graph, 8, 16)
        result = net(y, e)
        torch.testing.assert_close(result[:, 0], box_estimate(y, e, net.inverse)[:, 11:19], rtol=2e-5, atol=1e-6)


def test_blend_clamps_in_eval_mode_only():
    graph = presets.kernel_net((8, 12), (1, 2), name="small", hop=8)
    net = GraphNet(graph, InverseResponse.of_linear(2.0))
    y, e = window_of(graph, 8, 16)
    with torch.no_grad():
        net.layers["tail"].bias.fill_(2.0)
        assert net.train()(y, e, toned=True).max() > 1
        assert net.eval()(y, e, toned=True).max() == 1


def conv_alone(kernel, stride, transposed, frames):
    """A convolution layer, and PyTorch's own result on the whole tensor."""
    node = presets.conv("y", "x", 6, kernel, stride=stride, transpose=transposed, activation={"leaky_relu": 0.2})
    layer = Convolution(node, 5).double()
    torch.nn.init.normal_(layer.bias)
    x = torch.randn(2, 5, frames, 6, 8, dtype=torch.float64)
    functional = torch.nn.functional
    if transposed:
        padding = tuple((k - s) // 2 for k, s in zip(kernel, stride, strict=True))
        whole = functional.conv_transpose3d(x, layer.weight, layer.bias, stride, padding)
    else:
        whole = functional.conv3d(x, layer.weight, layer.bias, stride, tuple(k // 2 for k in kernel))
    return layer, x, functional.leaky_relu(whole, 0.2)


@pytest.mark.parametrize(
    ("kernel", "stride", "transposed"),
    [((3, 3, 3), (1, 1, 1), False), ((1, 3, 3), (1, 2, 2), False), ((5, 1, 3), (2, 1, 1), False),
     ((4, 4, 4), (2, 2, 2), True), ((3, 3, 3), (1, 1, 1), True), ((1, 2, 2), (1, 2, 2), True), ((2, 2, 2), (2, 2, 2), True)],
)  # fmt: skip
def test_frames_of_a_convolution_are_those_of_the_whole(kernel, stride, transposed):
    layer, x, whole = conv_alone(kernel, stride, transposed, 7)
    for first, end in ((0, whole.shape[2]), (1, 3), (whole.shape[2] - 2, whole.shape[2])):
        torch.testing.assert_close(layer(Frames(x), first, end, 7, None), whole[:, :, first:end])


def every_op(neighbours=(-5, 3)):
    """A graph of every operation, with strides in time, whose result frames need only a part of most tensors."""
    base = presets.paper((4, 4, 8), 1, 4)
    nodes = [dict(node) for node in base["nodes"]]
    nodes[1] |= {"inputs": ["measurement", "estimate", "logs"], "neighbours": list(neighbours)}
    nodes[1]["channels"] = ["measurement", "log_irradiance", "log_estimate"]
    nodes.insert(1, {"name": "logs", "op": "log_irradiance", "inputs": ["measurement"]})
    return {**base, "nodes": nodes, "window": {"frames": 32, "lead": 14, "hop": 4}}


@pytest.mark.parametrize("whole_convolutions", [False, True], ids=["by frame", "whole"])
@pytest.mark.parametrize("graph", [every_op(), presets.kernel_net((8, 12), (1, 2), name="small", hop=8)], ids=["every op", "kernels"])
def test_frames_that_no_result_needs_change_nothing(graph, whole_convolutions, monkeypatch):
    """Computing only what is needed gives what computing everything gives."""
    monkeypatch.setattr("pix2hdr_training.operations.has_matrix_unit", lambda: whole_convolutions)
    net = GraphNet(graph, InverseResponse.of_linear(2.0)).double().eval()
    y, e = window_of(graph, 8, 8)
    everything = json.loads(json.dumps(graph))
    window = everything["window"]
    everything["window"] = {"frames": window["frames"], "lead": 0, "hop": window["frames"]}
    whole = GraphNet(everything, net.inverse).double().eval()
    whole.load_state_dict(net.state_dict())
    with torch.no_grad():
        result = whole(y.double(), e.double())[:, :, window["lead"] : window["lead"] + window["hop"]]
        torch.testing.assert_close(net(y.double(), e.double()), result)
    assert layout.gflop_per_frame(graph) < layout.gflop_per_frame(everything) * window["frames"] / window["hop"]


def test_neighbours_are_the_same_pixels_at_other_times():
    nodes = presets.kernel_net((8,), (1,), name="small", hop=8)["nodes"][:3]
    nodes[2] = nodes[2] | {"channels": ["log_irradiance"], "neighbours": [-2, 1], "block": [1, 1, 1]}
    graph = {"version": 1, "name": "n", "pattern": "any", "window": {"frames": 6, "lead": 0, "hop": 6}, "nodes": nodes, "output": "features"}
    y, e = window_of(graph, 3, 5)
    inverse = InverseResponse.of_linear(2.0)
    features = GraphNet(graph, inverse)(y, e)
    irradiance = tone(inverse(y) / e)
    zeros = torch.zeros_like(irradiance[:, :2])
    torch.testing.assert_close(features[:, 0], irradiance)
    torch.testing.assert_close(features[:, 1], torch.cat([zeros, irradiance[:, :-2]], 1))
    torch.testing.assert_close(features[:, 2], torch.cat([irradiance[:, 1:], zeros[:, :1]], 1))


@pytest.mark.parametrize("name", presets.PRESETS)
def test_presets_are_valid_and_written(name):
    jsonschema = pytest.importorskip("jsonschema")
    graph = presets.PRESETS[name]()
    schema = json.loads((FORMAT / "graph.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    validator.validate(graph)
    for break_it in (lambda g: g.pop("window"), lambda g: g["nodes"][-1].update(op="fold"), lambda g: g["nodes"][-1].pop("inputs")):
        broken = json.loads(json.dumps(graph))
        break_it(broken)
        with pytest.raises(jsonschema.ValidationError):
            validator.validate(broken)
    assert (FORMAT / "presets" / f"{name}.json").read_text() == presets.to_json(graph)
    assert json.loads(presets.to_json(graph)) == graph
    rows, columns = layout.granularity(graph)
    shape = layout.shapes(graph, 4 * rows, 3 * columns)[graph["output"]]
    assert (shape.y, shape.x, shape.c) == (4 * rows, 3 * columns, 1)


def test_cost_counts_what_the_formula_says():
    """2·taps·channels per position, 1/8 of the pixels; each layer computes what the layers behind it reach."""
    w, hop = 16, 8
    graph = presets.kernel_net((w,), (2,), name="small", hop=hop)
    assert graph["window"] == {"frames": hop + 20, "lead": 10, "hop": hop}
    entry, temporal, spatial, tail = 9 * 7 * 8 * w, 3 * w * w, 9 * w * w, w * 32 * 8
    macs = (hop + 4) * entry + (hop + 2) * (temporal + spatial) + hop * (temporal + spatial + tail)
    assert layout.gflop_per_frame(graph) == pytest.approx(2e-9 * macs * 128 * 128 / 8 / hop)
    assert layout.gflop_per_frame(presets.PRESETS["tiny"]()) <= 0.1
    assert layout.gflop_per_frame(presets.PRESETS["fast"]()) <= 0.5


def test_blend_weighs_the_taps_that_lie_inside():
    base = presets.kernel_net((4,), (1,), name="small", hop=8)
    taps, block, n = [[0, -1, 2], [-2, 0, 0], [3, 1, -1]], [1, 2, 4], 4
    nodes = [node for node in base["nodes"] if node["op"] not in ("conv3d", "blend")]
    nodes.append(presets.conv("x", "features", 8 * n, (1, 1, 1)))
    nodes.append({"name": "y", "op": "blend", "inputs": ["x", "log_irradiance", "estimate"], "block": block, "taps": taps})
    graph = {**base, "nodes": nodes, "output": "y", "window": {"frames": 6, "lead": 1, "hop": 4}}
    net = GraphNet(graph, InverseResponse.of_linear(2.0)).double()
    torch.manual_seed(0)
    torch.nn.init.normal_(net.layers["x"].weight, std=0.1)
    y, e = (x.double() for x in window_of(graph, 4, 8))
    result = net(y, e, toned=True)[0, 0]
    everything = {**graph, "window": {"frames": 6, "lead": 0, "hop": 6}}
    net.graph = everything
    x = net(y, e, until="x")[0]
    logs, base = tone(net.inverse(y) / e)[0], tone(box_estimate(y, e, net.inverse))[0]
    for t, r, c in np.ndindex(4, 4, 8):
        weights = x[r % 2 * 4 + c % 4 :: 8, t + 1, r // 2, c // 4]
        v = base[t + 1, r, c] + weights[-1]
        for weight, (dt, dy, dx) in zip(weights, taps, strict=False):
            at = t + 1 + dt, r + dy, c + dx
            if all(0 <= i < size for i, size in zip(at, logs.shape, strict=True)):
                v = v + weight * (logs[at] - base[t + 1, r, c])
        torch.testing.assert_close(result[t, r, c], v)


def test_wrong_graphs_are_refused():
    graph = presets.kernel_net((8, 12), (1, 2), name="small", hop=8)
    graph["nodes"][-1]["inputs"] = ["nowhere", "estimate"]
    with pytest.raises(layout.GraphError, match="radiance.*nowhere"):
        GraphNet(graph, InverseResponse.of_linear(2.0))
    graph = presets.kernel_net((8, 12), (1, 2), name="small", hop=8)
    graph["nodes"][-1]["block"] = [8, 2, 2]
    with pytest.raises(layout.GraphError, match="radiance"):
        layout.shapes(graph, 8, 8)
    with pytest.raises(layout.GraphError, match="granularity"):
        layout.shapes(presets.kernel_net((8, 12), (1, 2), name="small", hop=8), 7, 8)


def test_paper_runs_and_its_weights_are_positive():
    graph = presets.paper((4, 4, 8), 1, 4)
    net = GraphNet(graph, InverseResponse.of_linear(2.0))
    y, e = window_of(graph, 8, 16)
    weights = net(y, e, until="weights")
    assert weights.shape == (1, 3, 4, 8, 16) and weights.min() > 0
    assert net(y, e).shape == (1, 1, 4, 8, 16)
