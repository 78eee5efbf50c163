"""Operations of the graph module against slow, independent statements of the same thing."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from pix2hdr_training import layout, presets
from pix2hdr_training.graph import GraphNet, box_estimate, fold, unfold
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


def test_fold_has_the_order_of_the_format_and_unfold_undoes_it():
    x = torch.arange(2 * 4 * 6 * 8).reshape(2, 4, 6, 8).double()
    bt, by, bx = 2, 3, 4
    folded = fold([x, -x - 1], (bt, by, bx))
    assert folded.shape == (2, bt * by * bx * 2, 2, 2, 2)
    for dt, dy, dx, i in np.ndindex(bt, by, bx, 2):
        value = folded[1, ((dt * by + dy) * bx + dx) * 2 + i, 1, 0, 1]
        source = x[1, bt + dt, dy, bx + dx]
        assert value == (source if i == 0 else -source - 1)
    assert torch.equal(unfold(fold([x], (bt, by, bx)), (bt, by, bx)), x)


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


def test_fast_with_a_zero_tail_is_the_box_estimate():
    graph = presets.fast(8, (3, 1, 3, 1), hop=8)
    net = GraphNet(graph, InverseResponse.of_linear(2.0)).eval()
    with torch.no_grad():
        net.layers["tail"].weight.zero_()
        y, e = window_of(graph, 8, 12)
        result = net.result(net(y, e))
        torch.testing.assert_close(result[:, 0], box_estimate(y, e, net.inverse)[:, 2:10], rtol=2e-5, atol=1e-6)


def test_unfold_clamps_in_eval_mode_only():
    graph = presets.fast(8, (3, 1, 3, 1), hop=8)
    net = GraphNet(graph, InverseResponse.of_linear(2.0))
    y, e = window_of(graph, 8, 12)
    with torch.no_grad():
        net.layers["tail"].bias.fill_(2.0)
        assert net.train()(y, e, toned=True).max() > 1
        assert net.eval()(y, e, toned=True).max() == 1


def test_both_ways_of_convolving_agree():
    """The 2D path of T = 1 and PyTorch's conv3d."""
    graph = presets.fast(8, (3, 1, 3, 1), hop=8)
    net = GraphNet(graph, InverseResponse.of_linear(2.0)).double()
    layer = net.layers["block1a"]
    x = torch.randn(2, 8, 1, 5, 7, dtype=torch.float64)
    direct = torch.nn.functional.conv3d(x, layer.weight, layer.bias, padding=(0, 1, 1))
    torch.testing.assert_close(layer(x, None), torch.nn.functional.leaky_relu(direct, 0.2))


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
    """fast: 2·9·(entry + block + tail) per position, 1/8 of the pixels, 3 frames of lead at both ends of a window."""
    w, hop = 16, 8
    macs = 9 * (3 * 24 * w + (1 + 3) * w * w + 3 * w * 8)
    graph = presets.fast(w, (3, 1, 3, 3), hop=hop)
    assert graph["window"] == {"frames": hop + 6, "lead": 3, "hop": hop}
    assert layout.gflop_per_frame(graph) == pytest.approx(2e-9 * macs * 128 * 128 / 8 * (hop + 6) / hop)
    assert layout.gflop_per_frame(presets.PRESETS["tiny"]()) <= 0.1


def test_wrong_graphs_are_refused():
    graph = presets.fast(8, (3, 1, 3, 1), hop=8)
    graph["nodes"][-1]["inputs"] = ["nowhere", "estimate"]
    with pytest.raises(layout.GraphError, match="radiance.*nowhere"):
        GraphNet(graph, InverseResponse.of_linear(2.0))
    graph = presets.fast(8, (3, 1, 3, 1), hop=8)
    graph["nodes"][-1]["block"] = [8, 2, 2]
    with pytest.raises(layout.GraphError, match="radiance"):
        layout.shapes(graph, 8, 8)
    with pytest.raises(layout.GraphError, match="granularity"):
        layout.shapes(presets.fast(8, (3, 1, 3, 1), hop=8), 7, 8)


def test_paper_runs_and_its_weights_are_positive():
    graph = presets.paper((4, 4, 8), 1, 4)
    net = GraphNet(graph, InverseResponse.of_linear(2.0))
    y, e = window_of(graph, 8, 12)
    weights = net(y, e, until="weights")
    assert weights.shape == (1, 3, 8, 8, 12) and weights.min() > 0
    assert net.result(net(y, e)).shape == (1, 1, 4, 8, 12)
