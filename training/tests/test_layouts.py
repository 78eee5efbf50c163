"""What Python says of layouts, patterns and responses against what Rust says, in weights-format/golden-layouts."""

import json
from functools import cache
from math import prod
from pathlib import Path

import numpy as np
import pytest
import torch
from pix2hdr_training import layout, operations, presets, tone
from pix2hdr_training.data import Pose, end_of_recording
from pix2hdr_training.export import read_weights
from pix2hdr_training.pattern import ExposureTable, exposure_table
from pix2hdr_training.response import InverseResponse

FORMAT = Path(__file__).resolve().parents[2] / "weights-format"


@cache
def golden(name):
    return json.loads((FORMAT / "golden-layouts" / f"{name}.json").read_text())


def graph_of(file):
    path = FORMAT / file
    return json.loads(path.read_text()) if path.suffix == ".json" else read_weights(path)[0]


def test_every_preset_and_golden_net_has_a_layout():
    files = [f"presets/{name}.json" for name in presets.PRESETS]
    files += [f"golden/{path.name}" for path in (FORMAT / "golden").iterdir() if not path.name.endswith(".io.safetensors")]
    assert sorted(files) == sorted(golden("nets"))


@pytest.mark.parametrize("file", golden("nets"))
def test_layouts_are_those_of_rust(file):
    graph, wanted = graph_of(file), golden("nets")[file]
    assert layout.granularity(graph) == tuple(wanted["granularity"][1:])
    height, width = wanted["size"]
    known = layout.shapes(graph, height, width)
    assert {name: [s.t, s.y, s.x, s.c] for name, s in known.items()} == wanted["shapes"]
    assert sum(map(prod, layout.tensor_shapes(graph).values())) == wanted["parameters"]
    needed = layout.needed_frames(graph)
    computed = {name: needed[name][1] - needed[name][0] for name in wanted["computed"]}
    assert computed == wanted["computed"]
    flop = 1e9 * layout.gflop_per_frame(graph, height, width) * graph["window"]["hop"]
    assert flop == pytest.approx(wanted["flop"], rel=1e-9)


@pytest.mark.parametrize("file", [file for file in golden("nets") if file.startswith(("presets/", "golden/net_"))])
def test_results_reach_as_far_in_time_as_rust_says(file):
    graph, wanted = graph_of(file), golden("nets")[file]
    step, _, _ = wanted["granularity"]
    far, hop = 64 * step, 4 * step
    long = {**graph, "window": {"frames": 2 * far + hop, "lead": far, "hop": hop}}
    first, end = layout.needed_frames(long)["measurement"]
    reached = max(far - first, end - far - hop)
    # With strides in time, Rust allows for the least favourable of a step's frames.
    assert wanted["reach"][0] - step < reached <= wanted["reach"][0]


@pytest.mark.parametrize("name", golden("patterns"))
def test_patterns_look_the_same_in_their_poses(name):
    pattern = golden("patterns")[name]
    table = exposure_table(name)
    assert table.saturation == pattern["saturation"] == table.exposures.min()
    poses = [Pose(tuple(pose["backwards"]), tuple(pose["shift"])) for pose in pattern["symmetries"]]
    assert poses[0] == Pose() and len(set(poses)) == len(poses)
    for pose in poses:
        places = [
            (shift - 1 - np.arange(size) if backwards else shift + np.arange(size)) % size
            for backwards, shift, size in zip(pose.backwards, pose.shift, table.exposures.shape, strict=True)
        ]
        assert np.array_equal(table.exposures[np.ix_(*places)], table.exposures)


@pytest.mark.parametrize("name", golden("ends"))
def test_ends_of_recordings_are_those_of_rust(name):
    period = golden("patterns")[name]["period"]
    for end in golden("ends")[name]:
        frames = np.arange(len(end["stand_ins"]))[:, None, None]
        assert end_of_recording(frames, *end["recorded"], period).ravel().tolist() == end["stand_ins"]


def test_only_the_built_in_patterns_are_known():
    assert ExposureTable.of(golden("patterns")["mpve-1-16"]).period == 32
    with pytest.raises(ValueError, match="mpve-1-4"):
        exposure_table("mpve-1-5")


def test_constants_are_those_of_rust():
    assert golden("constants") == {"mu": tone.MU, "saturated": operations.SATURATED}


@pytest.mark.parametrize("name", golden("responses"))
def test_responses_are_those_of_rust(name):
    curve = golden("responses")[name]
    inverse = InverseResponse(curve["inverse_response"])
    assert inverse.saturation == curve["saturation"] and inverse.linear == (name == "linear")
    levels = torch.linspace(0, 1, 1024, dtype=torch.float64)
    table = torch.tensor(curve["inverse_response"], dtype=torch.float64)
    torch.testing.assert_close(inverse(levels), table, rtol=1e-6, atol=1e-7)
    x, y = torch.tensor(curve["values"], dtype=torch.float64).T
    # Between levels the table is a straight line.
    torch.testing.assert_close(inverse.forward(x), y, rtol=0, atol=3e-4)
