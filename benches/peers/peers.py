"""The same weights in pix2hdr, PyTorch and ONNX Runtime, alternating on the same machine.

    python benches/peers/peers.py WEIGHTS --pix2hdr target/release/pix2hdr [--size 128x128] [--rounds 5] [--threads 2]
        [--device cuda] [--executor gpu] [--precision f16] [--peers eager-f32,eager-bf16,compiled-f32,onnx-f32]

Every round runs each peer on one window for some seconds, then `pix2hdr synth` on a capture of the same size and several
windows, so that all meet the same machine. Figures are ms per result frame of a window's computation, median over the
windows of a round: without reading files, compiling or converting for either side. The ratio is the peer's time over
that of pix2hdr, round by round; its median and its range are printed.
"""

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "training"))

from pix2hdr_training.export import net_from_weights, read_weights  # noqa: E402
from pix2hdr_training.pattern import exposure_table  # noqa: E402
from pix2hdr_training.response import InverseResponse  # noqa: E402

PATIENCE = 1.5  # seconds for each peer in a round
WINDOWS = 4  # of the capture that pix2hdr synthesises in a round


class Window:
    """A net in PyTorch and one window of measurement and exposure [1, T, H, W] on a device."""

    def __init__(self, weights: str, width: int, height: int, device: str):
        self.graph, _, _ = read_weights(weights)
        self.pattern = "mpve-1-4" if self.graph["pattern"] == "any" else self.graph["pattern"]
        table = exposure_table(self.pattern)
        net = net_from_weights(weights, InverseResponse.of_linear(table.saturation)).float()
        self.net = net.to(device, memory_format=torch.channels_last_3d)
        self.hop, frames = self.graph["window"]["hop"], self.graph["window"]["frames"]
        values = np.arange(frames * height * width, dtype=np.int64) * 7919 % 1024 / 1023
        exposure = table.window(0, frames, height, width)
        self.inputs = [
            torch.from_numpy(np.ascontiguousarray(array)).float().reshape(1, frames, height, width).to(device)
            for array in (values, exposure)
        ]
        self.device = device


def torch_peer(window: Window, compiled: bool, precision: str):
    """A function that runs the window once in PyTorch and waits for the result."""
    net = torch.compile(window.net) if compiled else window.net
    dtype = {"f32": None, "bf16": torch.bfloat16, "f16": torch.float16}[precision]

    def run() -> None:
        cast = torch.autocast(window.device, dtype) if dtype else contextlib.nullcontext()
        with torch.inference_mode(), cast:
            net(*window.inputs)
        if window.device == "cuda":
            torch.cuda.synchronize()

    return run


class Plain(torch.nn.Module):
    """A net as ONNX sees it: two inputs, one output."""

    def __init__(self, net: torch.nn.Module):
        super().__init__()
        self.net = net

    def forward(self, measurement: torch.Tensor, exposure: torch.Tensor) -> torch.Tensor:
        return self.net(measurement, exposure)


def onnx_peer(window: Window, threads: int):
    """A function that runs the window once in ONNX Runtime."""
    import onnxruntime

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "net.onnx"
        names = ["measurement", "exposure"]
        torch.onnx.export(Plain(window.net), tuple(window.inputs), str(path), dynamo=True, input_names=names)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        provider = "CUDAExecutionProvider" if window.device == "cuda" else "CPUExecutionProvider"
        session = onnxruntime.InferenceSession(path, options, providers=[provider])
    feed = dict(zip(("measurement", "exposure"), (x.cpu().numpy() for x in window.inputs), strict=True))
    feed = {i.name: feed[i.name] for i in session.get_inputs()}
    with torch.inference_mode():
        wanted = window.net(*window.inputs).cpu().numpy()
    difference = np.abs(session.run(None, feed)[0] - wanted).max()
    if not difference < 1e-3:
        raise ValueError(f"ONNX Runtime's result differs by {difference}")
    return lambda: session.run(None, feed)


def peers(names: list[str], window: Window, threads: int) -> dict:
    """The functions by name, each run once; names whose program is missing or fails are said and left out."""
    found = {}
    for name in names:
        kind, precision = name.split("-")
        try:
            run = onnx_peer(window, threads) if kind == "onnx" else torch_peer(window, kind == "compiled", precision)
            run()
            found[name] = run
        except Exception as error:  # noqa: BLE001: whatever a peer cannot do is no reason to measure no other
            print(f"{name}: left out, {type(error).__name__}: {str(error).splitlines()[0][:200]}", flush=True)
    return found


def times(run, hop: int) -> list[float]:
    """ms per result frame of repeated windows, until the patience is over."""
    taken, begin = [], time.perf_counter()
    while len(taken) < 3 or time.perf_counter() - begin < PATIENCE:
        start = time.perf_counter()
        run()
        taken.append((time.perf_counter() - start) * 1e3 / hop)
    return taken


class Ours:
    """`pix2hdr synth` on a capture that the program itself makes."""

    def __init__(self, args: argparse.Namespace, window: Window, folder: str):
        self.program, self.folder = str(Path(args.pix2hdr).resolve()), folder
        self.threads = args.threads
        self.options = ["--weights", str(Path(args.weights).resolve()), "--executor", args.executor, "--precision", args.precision]
        if args.adapter:
            self.options += ["--adapter", args.adapter]
        width, height = args.size.split("x")
        self._call("scene", "fan", "--width", width, "--height", height, "--frames", str(WINDOWS * window.hop), "--out", "truth.npy")
        self._call("sample", "truth.npy", "--pattern", window.pattern, "--out", "capture")

    def _call(self, *arguments: str) -> str:
        environment = {**os.environ, "RAYON_NUM_THREADS": str(self.threads)}
        result = subprocess.run(
            [self.program, *arguments], cwd=self.folder, env=environment, capture_output=True, text=True, check=False
        )
        if result.returncode != 0:
            sys.exit(f"pix2hdr {' '.join(arguments)}: {result.stderr[-2000:]}")
        return result.stdout

    def time(self) -> tuple[float, str]:
        """Median ms per result frame of its windows, and what it ran on."""
        report = json.loads(self._call("synth", "capture/capture.npy", *self.options, "--out", "result.npy", "--overwrite", "--json"))
        return report["ms_per_frame_median"], report["ran_on"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights")
    parser.add_argument("--pix2hdr", required=True, metavar="PROGRAM")
    parser.add_argument("--size", default="128x128", help="width x height")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"])
    parser.add_argument("--executor", default="cpu")
    parser.add_argument("--precision", default="f32")
    parser.add_argument("--adapter")
    parser.add_argument("--peers", default="eager-f32,eager-bf16,compiled-f32,onnx-f32")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    window = Window(args.weights, *map(int, args.size.split("x")), args.device)
    running = peers(args.peers.split(","), window, args.threads)
    with tempfile.TemporaryDirectory() as folder:
        ours = Ours(args, window, folder)
        own, ran_on = ours.time()
        print(f"{window.graph['name']}, {args.size}; pix2hdr on {ran_on}; PyTorch {torch.__version__} on {args.device},"
              f" {args.threads} threads; ms per result frame")
        ratios: dict[str, list[float]] = {name: [] for name in running}
        for number in range(1, args.rounds + 1):
            taken = {name: statistics.median(times(run, window.hop)) for name, run in running.items()}
            own, _ = ours.time()
            for name, value in taken.items():
                ratios[name].append(value / own)
            line = [f"{name} {value:.3f}" for name, value in {**taken, "pix2hdr": own}.items()]
            print(f"round {number}: " + ", ".join(line), flush=True)
    for name, values in ratios.items():
        print(f"{name} / pix2hdr: {statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})")


if __name__ == "__main__":
    main()
