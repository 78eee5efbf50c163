"""Data, losses and the training loop."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from fake_data import make_dataset
from pix2hdr_training import presets
from pix2hdr_training.data import Batch, Crops, Dataset, DatasetError, end_of_recording, miscalibrated, with_fixed_pattern
from pix2hdr_training.export import net_from_weights, read_weights, trainable_state, write_weights
from pix2hdr_training.graph import GraphNet
from pix2hdr_training.losses import PaperLoss, Vgg, log_mse, log_pattern_mse, mean_ssim
from pix2hdr_training.objective import Objective, inverse_node
from pix2hdr_training.operations import box_estimate
from pix2hdr_training.start import start_as_estimate
from pix2hdr_training.tone import inverse_tone, tone
from pix2hdr_training.train import Trainer, learning_rate, load_checkpoint, main, net_from_checkpoint
from pix2hdr_training.validate import main as score
from pix2hdr_training.validate import validate
from pix2hdr_training.widen import widened
from test_export import load_script
from test_layouts import golden

SMALL = {"fast": presets.kernel_net((8, 12), (1, 2), name="small", hop=8), "paper": presets.paper((4, 4, 8), 1, 4)}
ON_TILES = presets.paper_on_tiles((8, 12), (1, 2), 8, name="on_tiles", hop=4, reach=2)


def fake_vgg(folder):
    """An npz of the right shapes with random values."""
    rng = np.random.default_rng(0)
    arrays, inside = {}, 3
    for name, outside in (("conv1_1", 64), ("conv1_2", 64), ("conv2_1", 128), ("conv2_2", 128)):
        arrays[f"{name}.weight"] = rng.normal(0, (2 / (9 * inside)) ** 0.5, (outside, inside, 3, 3)).astype(np.float32)
        arrays[f"{name}.bias"] = np.zeros(outside, np.float32)
        inside = outside
    path = folder / "vgg.npz"
    np.savez(path, **arrays)
    return path


def test_crops_are_aligned_and_the_same_for_a_seed(data_folder):
    data = Dataset(data_folder)
    crops = Crops(data, SMALL["fast"], 6, 16, 3, ends=0.0, off=0.0)
    assert crops.starts == [1, 9]  # (4 + start + 11) divisible by 8
    assert data.window_starts(SMALL["paper"]["window"]) == list(range(2, 33, 4))
    a, b, c = crops(5), crops(5), crops(6)
    assert torch.equal(a.measurement, b.measurement) and torch.equal(a.truth, b.truth)
    assert not torch.equal(a.measurement, c.measurement)
    assert a.measurement.shape == (6, 30, 16, 16) and a.truth.shape == (6, 8, 16, 16)
    # Pixels of exposure 8 hold one value over a whole read-out, so the exposure table lies right.
    long = a.exposure[0, 0] == 8
    for frames in (slice(3, 11), slice(11, 19)):
        assert torch.all(a.measurement[:, frames][:, :, long] == a.measurement[:, frames][:, :1, long])


def test_crops_show_the_pattern_in_all_its_poses(tmp_path):
    # Pixels say which cell they are and how far from the middle of a read-out; both are the same in every pose.
    kinds = ((2, 1), (4, 2), (8, 0), (8, 4))
    frames, size, start = 40, 32, 4
    t, y, x = np.meshgrid(start + np.arange(frames), np.arange(size), np.arange(size), indexing="ij")
    cell = (x + 2 * y) % 4
    exposure, phase = (np.asarray([kind[i] for kind in kinds])[cell] for i in (0, 1))
    inside = (t - phase) % exposure
    counts = 16 * cell + np.minimum(inside, exposure - 1 - inside)
    folder = make_dataset(tmp_path / "poses", cubes=2, frames=frames, size=size, start=start)
    for shard in range(2):
        np.save(folder / f"measurement-{shard:03}.npy", counts[None].astype(np.uint16))
        np.save(folder / f"truth-{shard:03}.npy", (counts[None] + 100 * (t - start) / frames).astype(np.float16))
    meta = json.loads((folder / "dataset.json").read_text())
    meta["symmetries"] = golden("patterns")["mpve-1-4"]["symmetries"]
    (folder / "dataset.json").write_text(json.dumps(meta))
    data = Dataset(folder)
    crops = Crops(data, SMALL["fast"], 8, 16, 3, ends=0.0, off=0.0)
    assert all(len(poses) == 8 for poses in crops.poses.values())
    rising = set()
    for step in range(4):
        batch = crops(step)
        seen = np.rint(batch.measurement.numpy() * data.white)
        first = np.concatenate([counts[s : s + 30, :16, :16][None] for s in crops.starts])
        lead = SMALL["fast"]["window"]["lead"]
        for one, truth in zip(seen, batch.truth.numpy(), strict=True):
            assert any(np.array_equal(one, wanted) for wanted in first)
            # The truth is turned with it, and time may run either way.
            time = truth - one[lead : lead + 8]
            assert np.ptp(time[0]) < 0.5
            rising.add(bool(time[-1, 0, 0] > time[0, 0, 0]))
    assert rising == {True, False}


def test_a_pedestal_is_taken_off(tmp_path):
    window = SMALL["fast"]["window"]
    plain = make_dataset(tmp_path / "pedestal", cubes=2, size=16)
    before = Dataset(plain).read(0, window, 1, 0, 0, 16, 16)
    meta = json.loads((plain / "dataset.json").read_text())
    (plain / "dataset.json").write_text(json.dumps({**meta, "black_level": 48}))
    for shard in range(2):
        counts = np.load(plain / f"measurement-{shard:03}.npy")
        raised = np.rint(48 + counts * (975 / 1023)).astype(np.uint16)
        raised[:, :2] = 40  # noise below black
        np.save(plain / f"measurement-{shard:03}.npy", raised)
    measurement, truth = Dataset(plain).read(0, window, 1, 0, 0, 16, 16)
    assert np.array_equal(truth, before[1]) and measurement.dtype == np.float32
    assert np.all(measurement[0] == 0) and measurement.max() <= 1
    np.testing.assert_allclose(measurement[1:], before[0][1:], rtol=0, atol=0.6 / 975)


def test_ends_of_recordings_keep_the_phase():
    frames = np.arange(30, dtype=np.float32)[:, None, None]
    window = end_of_recording(frames, 5, 27, 8)[:, 0, 0]
    assert np.all(window[5:27] == np.arange(5, 27))
    assert np.all((window >= 5) & (window < 27)) and np.all((window - np.arange(30)) % 8 == 0)
    assert window[4] == 12 and window[27] == 19


def test_miscalibration_is_small_and_keeps_saturation():
    rng = np.random.default_rng(0)
    y = rng.random((4, 8, 8)).astype(np.float32)
    y[0] = 1.0
    exposure = rng.choice([2.0, 4.0, 8.0], y.shape)
    changed = [miscalibrated(rng, y, exposure) for _ in range(20)]
    assert all(np.all(c[0] == 1.0) and c.min() >= 0 and c.max() <= 1 and c.dtype == np.float32 for c in changed)
    assert all(0 < np.abs(c - y).max() < 0.08 for c in changed)


def test_fixed_patterns_last_and_repeat_with_the_tile():
    rng = np.random.default_rng(0)
    y = np.full((4, 32, 64), 0.4, np.float32)
    y[:, :2] = 1.0
    exposure = np.broadcast_to(np.tile([[2.0, 4.0, 8.0, 8.0], [8.0, 8.0, 2.0, 4.0]], (16, 16)), y.shape)
    changed = [with_fixed_pattern(rng, y, exposure, (2, 4)) for _ in range(20)]
    for c in changed:
        assert np.all(c[:, :2] == 1.0) and c.min() >= 0 and c.max() <= 1 and c.dtype == np.float32
        assert np.array_equal(c[0], c[3])
    # Positions differ more than the pixels at one position.
    worst = max(changed, key=lambda c: np.abs(c - y).max())[0, 2:]
    positions = worst.reshape(15, 2, 16, 4)
    assert positions.mean((0, 2)).std() > positions.std((0, 2)).mean() > 0


def test_the_pattern_loss_sees_only_what_repeats_with_the_tile():
    torch.manual_seed(0)
    truth = torch.rand(2, 3, 34, 36)
    noise = 0.01 * torch.randn(2, 3, 34, 36)
    grid = torch.zeros(34, 36)
    grid[::2, ::4] = 0.01
    floor = log_pattern_mse(truth, truth, (2, 4))
    # A level that is off is no pattern; noise hardly is one: its mean over 3 frames and 16 tiles has a 48th of its power.
    assert torch.allclose(log_pattern_mse(truth + 0.1, truth, (2, 4)), floor, atol=1e-3)
    assert log_pattern_mse(truth + noise, truth, (2, 4)) < np.log10(1e-4 / 30)
    # One of eight positions off by 0.01: mean square (0.01)² · (1/8 − 1/64).
    seen = log_pattern_mse(truth + grid, truth, (2, 4))
    assert torch.allclose(seen, torch.tensor(np.log10(1e-4 * 7 / 64 + 1e-8), dtype=seen.dtype), atol=1e-3)


def test_broken_data_sets_are_named(tmp_path, data_folder):
    with pytest.raises(DatasetError, match="dataset.json"):
        Dataset(tmp_path)
    meta = json.loads((data_folder / "dataset.json").read_text())
    (tmp_path / "dataset.json").write_text(json.dumps(meta))
    with pytest.raises(DatasetError, match="truth-000.npy"):
        Dataset(tmp_path)
    (tmp_path / "dataset.json").write_text(json.dumps({**meta, "period": 7}))
    with pytest.raises(DatasetError, match="reshape"):
        Dataset(tmp_path)
    (tmp_path / "dataset.json").write_text(json.dumps({**meta, "symmetries": [{"mirrored": True}]}))
    with pytest.raises(DatasetError, match="mirrored"):
        Dataset(tmp_path)
    with pytest.raises(DatasetError, match="granularity"):
        Crops(Dataset(data_folder), SMALL["fast"], 1, 18, 0)


def test_ssim_and_log_mse():
    torch.manual_seed(0)
    image = torch.rand(2, 20, 20, dtype=torch.float64)
    assert mean_ssim(image, image).item() == pytest.approx(1)
    assert mean_ssim(image, torch.rand_like(image)).item() < 0.5
    # Uniform images: the contrast term is 1, the luminance term has a closed form.
    a, b = torch.full((1, 15, 15), 0.2), torch.full((1, 15, 15), 0.6)
    assert mean_ssim(a, b).item() == pytest.approx((2 * 0.12 + 1e-4) / (0.04 + 0.36 + 1e-4), rel=1e-3)
    video = torch.zeros(2, 3, 4, 4)
    assert log_mse(video, video + 0.1, floor=0).item() == pytest.approx(-2)


@pytest.mark.parametrize(
    ("kind", "stage", "loss"),
    [("fast", "all", "log_mse"), ("fast", "all", "charbonnier"), ("fast", "all", "paper"), ("paper", "ldr", "paper"),
     ("paper", "hdr", "l1"), ("paper", "all", "paper")],
)  # fmt: skip
def test_steps_lower_the_loss_on_a_fixed_batch(kind, stage, loss, data_folder, tmp_path):
    torch.manual_seed(1)
    data, graph = Dataset(data_folder), SMALL[kind]
    net = GraphNet(graph, data.inverse)
    paper = PaperLoss(Vgg(fake_vgg(tmp_path)), 1.0, 1) if loss == "paper" else None
    trainer = Trainer(net, Objective(net, stage, loss, paper))
    before = {name: value.clone() for name, value in net.state_dict().items()}
    batch = Crops(data, graph, 2, 16, 0)(0)
    losses = [trainer.step(batch, 1e-3) for _ in range(4)]
    assert losses[-1] < losses[0] and all(map(math.isfinite, losses))
    changed = {name.split(".")[1] for name, value in net.state_dict().items() if not torch.equal(value, before[name])}
    if stage == "ldr":
        assert "ldr" in changed and "encoder1" in changed and not any(name.startswith("hdr") for name in changed)
    if stage == "hdr":
        assert "weights" in changed and "ldr" not in changed and "encoder1" not in changed


def test_a_curved_response_trains_too(curved_folder):
    data = Dataset(curved_folder)
    assert not data.inverse.linear
    net = GraphNet(SMALL["paper"], data.inverse)
    trainer = Trainer(net, Objective(net, "all", "log_mse"))
    batch = Crops(data, SMALL["paper"], 2, 16, 0)(0)
    assert math.isfinite(trainer.step(batch, 1e-3))
    assert net.layers["encoder1"].weight.grad.abs().sum() > 0


def test_zero_tail_scores_like_the_box_filter(data_folder):
    data = Dataset(data_folder)
    net = GraphNet(SMALL["fast"], data.inverse)
    with torch.no_grad():
        net.layers["tail"].weight.zero_()
    scores = validate(net, data)
    assert scores["cubes"] == 4 and set(scores["kinds"]) == {"pan", "static"}
    assert abs(scores["gain_db"]) < 1e-3 and 5 < scores["box_psnr_mu"] < 60


def test_a_weights_file_is_scored_on_data_sets(data_folder, tmp_path, capsys):
    data = Dataset(data_folder)
    net = GraphNet(SMALL["fast"], data.inverse)
    path = tmp_path / "w.safetensors"
    write_weights(path, net)
    assert score([str(path), str(data_folder), "--json"]) == 0
    (folder, scores), = json.loads(capsys.readouterr().out).items()
    assert folder == str(data_folder) and scores == validate(net, data)
    # Longer windows give the same where the lead is all that the net reaches.
    assert score([str(path), str(data_folder), str(data_folder), "--cubes", "1", "--window", "38", "11", "16"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 and "over 1 cubes" in lines[0]
    other = make_dataset(tmp_path / "other", cubes=2, pattern="mpve-1-8")
    for arguments, why in (([str(other)], "for pattern mpve-1-4, but"), ([str(data_folder), "--window", "60", "11", "38"], "hold no window")):
        assert score([str(path), *arguments]) == 1
        error = capsys.readouterr().err
        assert why in error and error.count("\n") == 1


def test_learning_rate_rises_and_falls():
    assert learning_rate(0, 1) < 0.1 and learning_rate(0.02, 1) > 0.99 and learning_rate(1, 1) == 0
    assert learning_rate(0.5, 1) == pytest.approx(0.5)


@pytest.fixture
def graph_file(tmp_path):
    path = tmp_path / "graph.json"
    path.write_text(presets.to_json(SMALL["fast"]))
    return path


def run(graph_file, data_folder, out, *more):
    arguments = ["--graph", graph_file, "--data", data_folder, "--out", out, "--batch", 2, "--crop", 16, "--log-seconds", 0]
    return main(list(map(str, [*arguments, *more])))


def test_fixed_patterns_are_trained_on_request(graph_file, data_folder, tmp_path, capsys):
    loss = []
    for name, more in (("plain", ()), ("against", ("--fixed-pattern",))):
        assert run(graph_file, data_folder, tmp_path / name, "--steps", 2, *more) == 0
        state = load_checkpoint(tmp_path / name / "checkpoint.pt")
        assert json.loads(state["provenance"])["fixed_pattern"] == bool(more)
        loss.append(float((tmp_path / name / "curve.csv").read_text().splitlines()[1].split(",")[2]))
    # What repeats with the tile is far less than 1, so its logarithm lowers the loss.
    assert loss[1] < loss[0]
    paper = tmp_path / "paper.json"
    paper.write_text(presets.to_json(SMALL["paper"]))
    assert run(paper, data_folder, tmp_path / "ldr", "--steps", 1, "--stage", "ldr", "--fixed-pattern") == 1
    assert "fixed patterns" in capsys.readouterr().err


def test_resuming_is_exact_and_weights_are_complete(graph_file, data_folder, tmp_path, monkeypatch):
    assert run(graph_file, data_folder, tmp_path / "a", "--steps", 6, "--val", data_folder) == 0
    # The same run, cut off after three steps by a signal, then resumed.
    real = Trainer.step

    def step(self, batch, lr):
        loss = real(self, batch, lr)
        if self.steps == 3:
            import signal

            signal.raise_signal(signal.SIGTERM)
        return loss

    monkeypatch.setattr(Trainer, "step", step)
    assert run(graph_file, data_folder, tmp_path / "b", "--steps", 6, "--val", data_folder) == 130
    monkeypatch.setattr(Trainer, "step", real)
    assert load_checkpoint(tmp_path / "b" / "checkpoint.pt")["step"] == 3
    assert run(graph_file, data_folder, tmp_path / "b", "--steps", 6) == 1, "must not overwrite a run"
    assert run(graph_file, data_folder, tmp_path / "b", "--steps", 7, "--resume") == 1, "another run length"
    assert run(graph_file, data_folder, tmp_path / "b", "--steps", 6, "--clip", 2, "--resume") == 1, "another step"
    final = tmp_path / "final.safetensors"
    arguments = ("--steps", 6, "--val", data_folder, "--resume", "--export", final)
    assert run(graph_file, data_folder, tmp_path / "b", *arguments) == 0
    one, two = (load_checkpoint(tmp_path / name / "checkpoint.pt") for name in "ab")
    for part in ("model", "ema"):
        for key, value in one[part].items():
            assert torch.equal(value, two[part][key]), key
    graph, tensors, metadata = read_weights(final)
    assert graph == SMALL["fast"] and json.loads(metadata["response"]) == "any"
    provenance = json.loads(metadata["provenance"])
    assert provenance["steps"] == 6 and provenance["scores"]["cubes"] == 4 and provenance["data"]["sha256"]
    rows = (tmp_path / "b" / "curve.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["step", "1", "2", "3", "4", "5", "6"]
    assert (tmp_path / "b" / "curve.png").read_bytes().startswith(b"\x89PNG")
    # convert.py writes the very same tensors.
    converted = tmp_path / "converted.safetensors"
    assert load_script("convert").main([str(tmp_path / "b" / "checkpoint.pt"), str(converted)]) == 0
    same_graph, same_tensors, _ = read_weights(converted)
    assert same_graph == graph and all(np.array_equal(value, tensors[key]) for key, value in same_tensors.items())
    inverse = Dataset(data_folder).inverse
    again = net_from_weights(final, inverse)
    from_checkpoint = net_from_checkpoint(two)
    batch = Crops(Dataset(data_folder), graph, 1, 16, 0)(0)
    with torch.no_grad():
        pair = (net(batch.measurement, batch.exposure) for net in (again, from_checkpoint))
        torch.testing.assert_close(*pair)


def test_minutes_end_a_run(graph_file, data_folder, tmp_path):
    assert run(graph_file, data_folder, tmp_path / "m", "--minutes", 0.01) == 0
    state = load_checkpoint(tmp_path / "m" / "checkpoint.pt")
    assert state["elapsed"] >= 0.6 and state["step"] >= 1


def test_bad_arguments_are_one_line(graph_file, data_folder, tmp_path, capsys):
    assert run(graph_file, data_folder, tmp_path / "x", "--steps", 1, "--loss", "paper") == 1
    assert "--vgg" in capsys.readouterr().err
    assert run(graph_file, data_folder, tmp_path / "x", "--steps", 1, "--stage", "ldr") == 1
    assert run(graph_file, Path("nowhere"), tmp_path / "x", "--steps", 1) == 1
    for length in (("--steps", 0), ("--minutes", 0)):
        with pytest.raises(SystemExit):
            run(graph_file, data_folder, tmp_path / "x", *length)
    assert "invalid positive float value" in capsys.readouterr().err


def test_data_that_do_not_belong_together_are_refused(graph_file, data_folder, curved_folder, tmp_path, capsys):
    other = make_dataset(tmp_path / "other", cubes=2, pattern="mpve-1-8")
    short = make_dataset(tmp_path / "short", cubes=2, frames=30)
    cases = [
        ((other,), "for pattern mpve-1-4, but"),
        ((data_folder, "--val", curved_folder), "another inverse_response"),
        ((data_folder, "--val", short), "hold no window"),
    ]
    for (folder, *more), why in cases:
        assert run(graph_file, folder, tmp_path / "run", "--steps", 1, *more) == 1
        error = capsys.readouterr().err
        assert why in error and error.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_widened_net_computes_the_same(data_folder):
    torch.manual_seed(2)
    data = Dataset(data_folder)
    narrow = GraphNet(SMALL["fast"], data.inverse)
    with torch.no_grad():
        narrow.layers["tail"].weight.mul_(50)  # far from the box filter
    wide = GraphNet(presets.kernel_net((16, 20), (1, 2), name="wide", hop=8), data.inverse)
    wide.load_state_dict(widened(narrow.state_dict(), wide))
    batch = Crops(data, SMALL["fast"], 2, 16, 0)(0)
    with torch.no_grad():
        before, after = (net.eval()(batch.measurement, batch.exposure, toned=True) for net in (narrow, wide))
    assert before.std() > 0.05
    torch.testing.assert_close(after, before, rtol=1e-4, atol=1e-5)
    # Repeated channels learn different things.
    weight = wide.layers["up0"].weight
    assert weight.shape[0] == 20 and not torch.equal(weight[0], weight[12])


def test_nets_that_cannot_be_widened_are_refused(data_folder):
    inverse = Dataset(data_folder).inverse

    def refused(narrow: dict, wide: dict, why: str) -> None:
        with pytest.raises(ValueError, match=why):
            widened(GraphNet(narrow, inverse).state_dict(), GraphNet(wide, inverse))

    kernels = SMALL["fast"]
    refused(presets.kernel_net((16, 20), (1, 2), name="wide", hop=8), kernels, "cannot become")
    refused(kernels, SMALL["paper"], "layers differ")
    # More taps: repeating channels would take one tap's weight for another's.
    refused(kernels, presets.kernel_net((8, 12), (1, 2), name="far", hop=8, reach=3), "no features")
    # More inputs, which are no repetition of others.
    channels = ("log_irradiance", "log_estimate", "saturated", "log_exposure")
    refused(kernels, presets.kernel_net((8, 12), (1, 2), name="more", hop=8, channels=channels), "no features")
    # Both parts of a concat twice as wide: the first one has as many channels as both had.
    refused(SMALL["paper"], presets.paper((8, 8, 16), 1, 8), "not the first part")
    refused(presets.kernel_net((4, 12), (1, 2), name="narrow", hop=4), ON_TILES, "not the first part")


def test_a_run_starts_from_a_weights_file(graph_file, data_folder, tmp_path):
    assert run(graph_file, data_folder, tmp_path / "first", "--steps", 3) == 0
    weights = tmp_path / "first" / "weights.safetensors"
    # A learning rate of zero: what comes out is what went in.
    more = ("--steps", 1, "--lr", 0, "--window", 34, 11, 12, "--init", weights)
    assert run(graph_file, data_folder, tmp_path / "second", *more) == 0
    (_, before, _), (graph, after, metadata) = map(read_weights, (weights, tmp_path / "second" / "weights.safetensors"))
    assert all(np.array_equal(before[name], after[name]) for name in before)
    provenance = json.loads(metadata["provenance"])
    assert provenance["start"]["steps"] == 3 and provenance["window"]["hop"] == 12
    # Whatever it was trained on, the net's windows are the graph's, in a file made of the checkpoint too.
    checkpoint, converted = tmp_path / "second" / "checkpoint.pt", tmp_path / "converted.safetensors"
    assert load_script("convert").main([str(checkpoint), str(converted)]) == 0
    assert graph == read_weights(converted)[0] == SMALL["fast"]


def test_videos_start_as_the_estimate_and_fusion_with_the_lowest_exposure(data_folder):
    data = Dataset(data_folder)
    torch.manual_seed(0)
    net = GraphNet(ON_TILES, data.inverse).eval()
    batch = Crops(data, ON_TILES, 4, 16, 0, ends=0.0, off=0.0)(9)
    box = tone(box_estimate(batch.measurement, batch.exposure, data.inverse))
    result = slice(ON_TILES["window"]["lead"], ON_TILES["window"]["lead"] + ON_TILES["window"]["hop"])
    exposures = torch.tensor(inverse_node(ON_TILES)["exposures"]).view(-1, 1, 1, 1)
    wanted = torch.log(inverse_tone(box[:, None, result]) * exposures / data.inverse.saturation)

    def distance() -> float:
        with torch.no_grad():
            logits = torch.logit(net(batch.measurement, batch.exposure, until="ldr"), eps=1e-6)
        return float((logits - wanted).square().mean().sqrt())

    before = distance()
    assert start_as_estimate(net)
    assert distance() < 0.35 < 1.0 < before
    with torch.no_grad():
        weights = net(batch.measurement, batch.exposure, until="weights").mean((0, 2, 3, 4))
    assert int(weights.argmax()) == 0 and weights[0] > 2.0 and float(weights[1:].max()) < 0.3
    # Where the videos' layer does not see the estimate, nothing is touched.
    for graph in SMALL.values():
        other = GraphNet(graph, data.inverse)
        state = {name: value.clone() for name, value in other.state_dict().items()}
        assert not start_as_estimate(other)
        assert all(torch.equal(state[name], value) for name, value in other.state_dict().items())


def test_ldr_net_starts_as_a_trained_kernel_net(data_folder):
    torch.manual_seed(2)
    data = Dataset(data_folder)
    graph = presets.kernel_net((8, 12), (1, 2), name="kernels")
    kernels, both = (GraphNet({**g, "window": ON_TILES["window"]}, data.inverse).eval() for g in (graph, ON_TILES))
    both.load_state_dict(widened(kernels.state_dict(), both))
    batch = Crops(data, ON_TILES, 2, 16, 0)(0)
    with torch.no_grad():
        features = [net(batch.measurement, batch.exposure, until="fine") for net in (kernels, both)]
    torch.testing.assert_close(*features)
    # The kernels do not see HDR-net yet.
    tail = both.layers["tail"].weight
    assert torch.equal(tail[:, :8], kernels.layers["tail"].weight) and not tail[:, 8:].any()


def test_batch_norm_does_not_start_from_a_weights_file(data_folder, tmp_path):
    data = Dataset(data_folder)
    write_weights(tmp_path / "w.safetensors", GraphNet(SMALL["paper"], data.inverse).eval())
    with pytest.raises(ValueError, match="batch norm"):
        trainable_state(tmp_path / "w.safetensors")
