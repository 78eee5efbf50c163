"""`python -m pix2hdr_training.train`: trains a layer graph on a data set of `pix2hdr dataset`."""

import argparse
import contextlib
import copy
import io
import json
import math
import platform
import signal
import sys
import time
from pathlib import Path

import torch

from .curve import Curve
from .data import Batch, Crops, Dataset, Prefetch
from .export import trainable_state, write_atomically, write_weights
from .graph import GraphNet
from .layout import gflop_per_frame
from .losses import SIMPLE, PaperLoss, Vgg
from .objective import STAGES, Objective, inverse_node
from .response import InverseResponse
from .start import start_as_estimate
from .validate import check_pattern, check_windows, summary, validate
from .widen import widened

CHECKPOINT = "pix2hdr-checkpoint/1"
WARM_UP = 0.02  # share of the run in which the learning rate rises
SAME_ON_RESUME = (
    "batch", "crop", "seed", "loss", "stage", "lr", "steps", "minutes", "fixed_pattern", "ema", "clip", "bf16",
    "perceptual_weight", "perceptual_frames",
)


def learning_rate(progress: float, base: float) -> float:
    """Linear rise over the first 2% of the run, then a cosine to zero; progress in [0, 1]."""
    rise = min(1.0, max(progress / WARM_UP, 0.05))
    return base * rise * 0.5 * (1.0 + math.cos(math.pi * min(progress, 1.0)))


class Trainer:
    """Net, optimiser and averaged weights; one `step` at a time."""

    def __init__(self, net: GraphNet, objective: Objective, *, ema: float = 0.999, clip: float = 1.0, bf16: bool = False):
        self.net, self.objective = net, objective
        self.averaged = copy.deepcopy(net).eval()
        self.averaged.requires_grad_(False)
        objective.set_mode(net)
        self.parameters = objective.trained_parameters(net)
        self.optimiser = torch.optim.Adam(self.parameters, lr=1e-3, betas=(0.9, 0.999))
        self.ema, self.clip, self.bf16 = ema, clip, bf16
        self.steps = 0
        self.skipped = 0

    def step(self, batch: Batch, lr: float) -> float:
        """One update; returns the loss before it. A step whose gradient is not finite changes nothing."""
        for group in self.optimiser.param_groups:
            group["lr"] = lr
        self.objective.set_mode(self.net)
        device = batch.measurement.device.type
        cast = torch.autocast(device, torch.bfloat16) if self.bf16 else contextlib.nullcontext()
        with cast:
            loss = self.objective(self.net, batch)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, self.clip)
        if torch.isfinite(norm):
            self.optimiser.step()
            self.skipped = 0
        else:
            self.skipped += 1
            if self.skipped >= 20:
                raise RuntimeError("20 steps in a row without a finite gradient: lower --lr")
        self.steps += 1
        self._average()
        return float(loss.detach())

    @torch.no_grad()
    def _average(self) -> None:
        # The average may forget the start quickly.
        decay = min(self.ema, (1 + self.steps) / (10 + self.steps))
        torch._foreach_lerp_(list(self.averaged.parameters()), list(self.net.parameters()), 1 - decay)
        for kept, now in zip(self.averaged.buffers(), self.net.buffers(), strict=True):
            kept.copy_(now)

    def state(self) -> dict:
        """All that `load` needs to go on exactly."""
        return {
            "model": self.net.state_dict(),
            "ema": self.averaged.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "step": self.steps,
            "rng": torch.get_rng_state(),
        }

    def load(self, state: dict) -> None:
        """Takes up a `state`."""
        self.net.load_state_dict(state["model"])
        self.averaged.load_state_dict(state["ema"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.steps = state["step"]
        torch.set_rng_state(state["rng"])


def load_checkpoint(path) -> dict:
    """A checkpoint as a dictionary; ValueError where the file is none."""
    state = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(state, dict) or state.get("format") != CHECKPOINT:
        raise ValueError(f"{path}: not a {CHECKPOINT} file")
    return state


def starting_state(path: Path) -> tuple[dict, dict]:
    """Averaged weights to start from, and where they come from, of a checkpoint or a weights file."""
    if path.suffix == ".safetensors":
        return trainable_state(path)
    state = load_checkpoint(path)
    return state["ema"], json.loads(state["provenance"])


def net_from_checkpoint(state: dict) -> GraphNet:
    """The averaged net of a checkpoint, in eval mode."""
    net = GraphNet(json.loads(state["graph"]), InverseResponse(state["inverse_response"]))
    net.load_state_dict(state["ema"])
    return net.eval()


def response_of(graph: dict, dataset: Dataset):
    """The `response` of the weights file: `any` where the net sees irradiance only, else the data set's."""
    sees_pixels = inverse_node(graph) is not None or any(
        "measurement" in node["inputs"] and node["op"] in ("conv3d", "conv_transpose3d", "concat")
        or node["op"] == "features" and "measurement" in node["channels"]
        for node in graph["nodes"]
    )
    if not sees_pixels:
        return "any"
    if "response" in dataset.meta:
        return dataset.meta["response"]
    if dataset.inverse.linear:
        return "linear"
    raise ValueError(f"{dataset.folder}: this net depends on the response, but dataset.json has no `response`")


def positive(kind):
    """A parser of numbers above 0."""

    def parse(text: str):
        value = kind(text)
        if not value > 0:
            raise ValueError
        return value

    parse.__name__ = f"positive {kind.__name__}"  # what argparse calls it
    return parse


def parse_arguments(arguments=None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m pix2hdr_training.train", description=__doc__)
    parser.add_argument("--graph", type=Path, required=True, help="layer graph (JSON)")
    parser.add_argument("--data", type=Path, required=True, help="data set to train on")
    parser.add_argument("--val", type=Path, help="data set of held-out cubes")
    parser.add_argument("--val-cubes", type=int, default=0, help="validate on the first N cubes (0: all)")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run: checkpoint, weights, curve")
    length = parser.add_mutually_exclusive_group(required=True)
    length.add_argument("--steps", type=positive(int), help="length of the run in steps (repeatable)")
    length.add_argument("--minutes", type=positive(float), help="length of the run in minutes of training, without validation")
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--crop", type=int, default=64, help="pixels at each side")
    parser.add_argument("--window", type=int, nargs=3, metavar=("FRAMES", "LEAD", "HOP"),
                        help="train on other windows than the graph's: for nets whose lead is all that they reach in time")
    parser.add_argument("--lr", type=float, default=2e-3)
    parser.add_argument("--loss", choices=[*SIMPLE, "paper"], default="log_mse")
    parser.add_argument("--stage", choices=STAGES, default="all", help="ldr, hdr: the paper's two stages")
    parser.add_argument("--fixed-pattern", action="store_true",
                        help="train against fixed patterns: in half of the crops, and once more in the loss")
    parser.add_argument("--init", type=Path, help="start from these weights, a checkpoint's or a .safetensors file's: of the same net, a narrower one, or a part of it")
    parser.add_argument("--vgg", type=Path, help="VGG16 weights (npz) for --loss paper")
    parser.add_argument("--perceptual-weight", type=float, default=1.0)
    parser.add_argument("--perceptual-frames", type=int, default=0, help="frames per window in L_perc (0: all)")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--ema", type=float, default=0.999, help="decay of the averaged weights")
    parser.add_argument("--clip", type=float, default=1.0, help="largest norm of the gradient")
    parser.add_argument("--bf16", action="store_true", help="bfloat16 autocast; only for processors that have it (AMX, AVX-512 BF16)")
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in --out, if there is one")
    parser.add_argument("--checkpoint-minutes", type=float, default=5.0)
    parser.add_argument("--log-seconds", type=float, default=10.0)
    parser.add_argument("--export", type=Path, help="copy the final weights file here too")
    parser.add_argument("--f16", action="store_true", help="weights files hold F16")
    return parser.parse_args(arguments)


class Run:
    """A training run in a folder: loop, checkpoints, validation, weights files."""

    def __init__(self, args: argparse.Namespace):
        self.args = args
        torch.set_num_threads(args.threads)
        torch.manual_seed(args.seed)
        self.exported = json.loads(args.graph.read_text())
        self.graph = dict(self.exported)
        if args.window:
            self.graph["window"] = dict(zip(("frames", "lead", "hop"), args.window, strict=True))
        self.data = Dataset(args.data)
        self.val = Dataset(args.val) if args.val else None
        self._check_data()
        self.response = response_of(self.graph, self.data)
        net = GraphNet(self.graph, self.data.inverse).to(args.device)
        start_as_estimate(net)
        self.start: dict | None = None  # provenance of the weights that the run starts from
        paper = None
        if args.loss == "paper":
            if args.vgg is None:
                raise ValueError("--loss paper needs --vgg")
            paper = PaperLoss(Vgg(args.vgg).to(args.device), args.perceptual_weight, args.perceptual_frames)
        if args.init:
            try:
                state, self.start = starting_state(args.init)
                net.load_state_dict(widened(state, net, args.seed))
                fresh = [name for name in net.layers if f"layers.{name}.weight" not in state]
                if fresh:
                    print(f"{args.init} lacks {len(fresh)} layers, which start afresh: {', '.join(fresh)}", flush=True)
            except ValueError as error:
                raise ValueError(f"{args.init}: {error}") from error
        self.crops = Crops(self.data, self.graph, args.batch, args.crop, args.seed, fixed_pattern=args.fixed_pattern)
        self.elapsed = 0.0  # seconds of training, over all resumptions
        self.scores: dict | None = None
        self.checkpoint_path = args.out / "checkpoint.pt"
        args.out.mkdir(parents=True, exist_ok=True)
        resume = args.resume and self.checkpoint_path.exists()
        if self.checkpoint_path.exists() and not resume:
            raise ValueError(f"{self.checkpoint_path} exists: --resume, or another --out")
        tile = self.data.table.tile if args.fixed_pattern else None
        objective = Objective(net, args.stage, args.loss, paper, tile)
        self.trainer = Trainer(net, objective, ema=args.ema, clip=args.clip, bf16=args.bf16)
        if resume:
            self._resume()
        self.curve = Curve(args.out, keep_until=self.trainer.steps)

    def _check_data(self) -> None:
        """ValueError where the graph, the data and the held-out cubes don't belong together."""
        check_pattern(self.graph, self.data)
        if self.val is None:
            return
        for key in ("pattern", "inverse_response"):
            if self.val.meta.get(key) != self.data.meta.get(key):
                raise ValueError(f"{self.val.folder} has another {key} than {self.data.folder}")
        check_windows(self.graph, self.val)

    def _settings(self) -> dict:
        settings = {key: getattr(self.args, key) for key in SAME_ON_RESUME}
        return {**settings, "data": self.data.digest, "graph": self.graph}

    def _resume(self) -> None:
        state = load_checkpoint(self.checkpoint_path)
        before, now = json.loads(state["settings"]), self._settings()
        different = [key for key in now if before.get(key) != now[key]]
        if different:
            raise ValueError(f"{self.checkpoint_path}: made with another {', '.join(different)}")
        self.trainer.load(state)
        self.elapsed = state["elapsed"]
        self.scores = json.loads(state["scores"])
        self.start = json.loads(state["provenance"]).get("start")
        print(f"resumed at step {self.trainer.steps}, {clock(self.elapsed)} trained", flush=True)

    def progress(self) -> float:
        """Share of the run that is done."""
        if self.args.steps:
            return self.trainer.steps / self.args.steps
        return self.elapsed / (60.0 * self.args.minutes)

    def save(self) -> None:
        """Checkpoint and weights file."""
        state = {
            **self.trainer.state(),
            "format": CHECKPOINT,
            "graph": json.dumps(self.exported),
            "inverse_response": self.data.inverse.table.tolist(),
            "response": json.dumps(self.response),
            "provenance": json.dumps(self.provenance()),
            "elapsed": self.elapsed,
            "scores": json.dumps(self.scores),
            "settings": json.dumps(self._settings()),
        }
        buffer = io.BytesIO()
        torch.save(state, buffer)
        write_atomically(self.checkpoint_path, buffer.getvalue())
        self.write_weights(self.args.out / "weights.safetensors")
        self.curve.draw()

    def write_weights(self, path: Path) -> None:
        """The averaged weights as they are now."""
        net = self.trainer.averaged
        write_weights(path, net, self.exported, response=self.response, provenance=self.provenance(), half=self.args.f16)

    def provenance(self) -> dict:
        """What the weights were trained on and how."""
        args = self.args
        return {
            "data": {"seed": self.data.meta.get("seed"), "sha256": self.data.digest, "cubes": len(self.data)},
            "pattern": self.data.meta.get("pattern"),
            "seed": args.seed,
            "steps": self.trainer.steps,
            "hours": round(self.elapsed / 3600.0, 4),
            "batch": args.batch,
            "crop": args.crop,
            "lr": args.lr,
            "loss": args.loss,
            "fixed_pattern": args.fixed_pattern,
            "bf16": args.bf16,
            "window": self.graph["window"],
            "stage": args.stage,
            "hardware": hardware(args.device, args.threads),
            "torch": torch.__version__,
            "scores": self.scores,
            "start": self.start,
        }

    def score(self) -> None:
        """Validates the averaged weights, if there are held-out cubes."""
        if self.val is None:
            return
        self.scores = validate(self.trainer.averaged, self.val, self.args.val_cubes)
        print(f"validation: {summary(self.scores)}", flush=True)

    def train(self) -> bool:
        """Trains to the end; False if it was interrupted (a checkpoint is written either way)."""
        args, trainer = self.args, self.trainer
        interrupted: list[int] = []
        before = {s: signal.signal(s, lambda number, _: interrupted.append(number)) for s in (signal.SIGINT, signal.SIGTERM)}
        print(
            f"{self.graph['name']}: {gflop_per_frame(self.graph):.3f} GFLOP per 128×128 frame,"
            f" {sum(p.numel() for p in trainer.parameters)} trained values, {len(self.data)} cubes",
            flush=True,
        )
        batches = Prefetch(self.crops, trainer.steps)
        losses: list[float] = []
        logged = saved = started = time.monotonic()
        first = trainer.steps
        paused = 0.0
        try:
            while self.progress() < 1.0 and not interrupted:
                begin = time.monotonic()
                lr = learning_rate(self.progress(), args.lr)
                losses.append(trainer.step(next(batches).to(args.device), lr))
                now = time.monotonic()
                self.elapsed += now - begin
                if now - logged >= args.log_seconds or self.progress() >= 1.0:
                    rate = (trainer.steps - first) / (now - started - paused)
                    left = (args.steps - trainer.steps) / rate if args.steps else 60 * args.minutes - self.elapsed
                    mean = sum(losses) / len(losses)
                    self.curve.add(trainer.steps, self.elapsed, mean, lr)
                    print(
                        f"step {trainer.steps}  {100 * min(self.progress(), 1.0):5.1f}%  loss {mean:.4f}  lr {lr:.2e}"
                        f"  {rate:.2f} steps/s  left {clock(left)}",
                        flush=True,
                    )
                    losses, logged = [], now
                if now - saved >= 60 * args.checkpoint_minutes and self.progress() < 1.0:
                    self.score()
                    self._note_score()
                    self.save()
                    saved = time.monotonic()
                    paused += saved - now
        finally:
            batches.close()
            for number, handler in before.items():
                signal.signal(number, handler)
        if not interrupted:
            self.score()
            self._note_score()
        self.save()
        if interrupted:
            print(f"interrupted at step {trainer.steps}: checkpoint written, go on with --resume", flush=True)
            return False
        if args.export:
            self.write_weights(args.export)
        print(f"done: {trainer.steps} steps in {clock(self.elapsed)}, {args.out / 'weights.safetensors'}", flush=True)
        return True

    def _note_score(self) -> None:
        if self.scores is not None:
            self.curve.add_score(self.trainer.steps, self.elapsed, self.scores)


def hardware(device: str, threads: int) -> str:
    """The processor's name, as far as the system tells."""
    if device.startswith("cuda"):
        return torch.cuda.get_device_name(device)
    name = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                name = line.split(":", 1)[1].strip()
                break
    return f"{name}, {threads} threads"


def clock(seconds: float) -> str:
    """h:mm:ss."""
    whole = max(0, round(seconds))
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"


def main(arguments=None) -> int:
    args = parse_arguments(arguments)
    try:
        return 0 if Run(args).train() else 130
    except (OSError, ValueError, RuntimeError) as error:
        print(f"train: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
