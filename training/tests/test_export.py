"""Weights files, checkpoints and the golden files."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from pix2hdr_training import presets
from pix2hdr_training.export import net_from_weights, read_weights, write_weights
from pix2hdr_training.graph import GraphNet
from pix2hdr_training.response import InverseResponse
from safetensors import safe_open
from test_graph import window_of

FORMAT = Path(__file__).resolve().parents[2] / "weights-format"
LINEAR = InverseResponse.of_linear(2.0)


def load_script(name):
    spec = importlib.util.spec_from_file_location(name, FORMAT / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("graph", [presets.kernel_net((8, 16), (1, 2), name="small", hop=8), presets.paper((4, 4, 8), 1, 4)], ids=["fast", "paper"])
def test_exported_net_gives_the_same_output(graph, tmp_path):
    torch.manual_seed(0)
    net = GraphNet(graph, LINEAR).train()
    y, e = window_of(graph, 8, 16)
    with torch.no_grad():
        for _ in range(3):  # the batch norms gather statistics
            net(y, e)
        net.eval()
        expected = net(y, e)
        path = tmp_path / "w.safetensors"
        write_weights(path, net, provenance={"steps": 3})
        torch.testing.assert_close(net_from_weights(path, LINEAR)(y, e), expected, rtol=1e-4, atol=1e-5)
        write_weights(path, net, half=True)
        half = net_from_weights(path, LINEAR)(y, e)
    torch.testing.assert_close(half, expected, rtol=0.05, atol=0.01)
    assert not torch.equal(half, expected)
    read, tensors, metadata = read_weights(path)
    assert read == graph and set(metadata) == {"format", "graph", "response", "provenance"}
    assert all(value.dtype == np.float16 for value in tensors.values())


def test_what_is_not_finite_is_not_written(tmp_path):
    net = GraphNet(presets.kernel_net((4,), (1,), name="small", hop=8), LINEAR)
    with torch.no_grad():
        net.layers["tail"].bias[3] = 1e6
    with pytest.raises(ValueError, match="tail.bias.*float16"):
        write_weights(tmp_path / "w.safetensors", net, half=True)
    assert not list(tmp_path.iterdir())


def test_golden_files_are_what_this_package_computes(tmp_path):
    """Regenerated from scratch: same files, same weights, same results."""
    make_golden = load_script("make_golden")
    make_golden.main(["--out", str(tmp_path)])
    made = sorted(p.name for p in tmp_path.iterdir())
    stored = sorted(p.name for p in (FORMAT / "golden").glob("*.safetensors"))
    assert made == stored and len(made) >= 100
    assert sum(p.stat().st_size for p in (FORMAT / "golden").iterdir()) < 2e6
    for name in made:
        with safe_open(tmp_path / name, "numpy") as a, safe_open(FORMAT / "golden" / name, "numpy") as b:
            assert a.metadata() == b.metadata() and set(a.keys()) == set(b.keys())
            for key in a.keys():
                # Only the last bit of a float64 sum may differ between machines.
                np.testing.assert_allclose(a.get_tensor(key), b.get_tensor(key), rtol=2e-7, atol=1e-9, err_msg=name)


def test_golden_graphs_fit_the_schema():
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(json.loads((FORMAT / "graph.schema.json").read_text()))
    used = set()
    for path in sorted((FORMAT / "golden").glob("*.safetensors")):
        if not path.name.endswith(".io.safetensors"):
            graph, _, _ = read_weights(path)
            validator.validate(graph)
            used |= {node["op"] for node in graph["nodes"]}
    operations = {"box_estimate", "features", "conv3d", "conv_transpose3d", "concat", "inverse_response", "fuse", "log_irradiance", "blend"}
    assert used == operations
