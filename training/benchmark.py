"""Time per frame of a weights file in PyTorch, beside another program that runs the same weights.

    python benchmark.py WEIGHTS [--size HEIGHTxWIDTH] [--rounds N] [--threads N]
        [--against "cargo bench --bench cpu -- {weights} --size {size} --threads {threads}"]

Every round runs each precision on one window, and then the other program, so that all meet the same machine. Times
are the shortest and the median window of a round, in ms per result frame, without reading or converting the weights.
The other program prints a line `per result frame: SHORTEST ms, median MEDIAN ms …`; the ratios are PyTorch's time
over that program's, round by round.
"""

import argparse
import re
import shlex
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parent))

from pix2hdr_training.export import net_from_weights, read_weights  # noqa: E402
from pix2hdr_training.pattern import exposure_table  # noqa: E402
from pix2hdr_training.response import InverseResponse  # noqa: E402

PATIENCE = 1.5  # seconds for each precision in a round


class Runner:
    """A net, ready to run the window that `benches/cpu.rs` runs."""

    def __init__(self, weights: str, height: int, width: int):
        graph, _, _ = read_weights(weights)
        table = exposure_table("mpve-1-4" if graph["pattern"] == "any" else graph["pattern"])
        self.net = net_from_weights(weights, InverseResponse.of_linear(table.saturation)).float()
        self.net = self.net.to(memory_format=torch.channels_last_3d)
        window = graph["window"]
        self.hop = window["hop"]
        values = np.arange(window["frames"] * height * width, dtype=np.int64) * 7919 % 1024 / 1023
        self.measurement = torch.from_numpy(values.reshape(1, window["frames"], height, width)).float()
        exposure = table.window(0, window["frames"], height, width)
        self.exposure = torch.from_numpy(exposure[None]).float()

    def run(self) -> torch.Tensor:
        """The result frames."""
        return self.net.result(self.net(self.measurement, self.exposure))

    def times(self, precision: str) -> list[float]:
        """ms per result frame of windows, until the patience is over."""
        half = torch.autocast("cpu", dtype=torch.bfloat16, enabled=precision == "bf16")
        with torch.inference_mode(), half:
            self.run()
            times, begin = [], time.perf_counter()
            while len(times) < 3 or time.perf_counter() - begin < PATIENCE:
                start = time.perf_counter()
                self.run()
                times.append((time.perf_counter() - start) * 1e3 / self.hop)
        return times


def other_times(command: str) -> tuple[float, float]:
    """Shortest and median ms per result frame that a program prints."""
    result = subprocess.run(shlex.split(command), capture_output=True, text=True, check=False)
    found = re.search(r"per result frame: ([0-9.]+) ms, median ([0-9.]+) ms", result.stdout)
    if result.returncode != 0 or not found:
        sys.exit(f"{command}: no time per frame\n{result.stderr[-2000:]}")
    return float(found[1]), float(found[2])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights")
    parser.add_argument("--size", default="128x128")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--against", metavar="COMMAND")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    height, width = map(int, arguments.size.split("x"))
    runner = Runner(arguments.weights, height, width)
    command = arguments.against and arguments.against.format(
        weights=arguments.weights, size=arguments.size, threads=arguments.threads
    )

    print(f"PyTorch {torch.__version__}, {arguments.threads} threads; ms per result frame, shortest (median)")
    ratios: dict[str, list[tuple[float, float]]] = {"f32": [], "bf16": []}
    for round_number in range(1, arguments.rounds + 1):
        measured = {}
        for precision in ratios:
            times = runner.times(precision)
            measured[precision] = (min(times), statistics.median(times))
        line = [f"{name} {least:.3f} ({median:.3f})" for name, (least, median) in measured.items()]
        if command:
            other = other_times(command)
            line.append(f"other {other[0]:.3f} ({other[1]:.3f})")
            for name, own in measured.items():
                ratios[name].append((own[0] / other[0], own[1] / other[1]))
        print(f"round {round_number}: " + ", ".join(line), flush=True)
    for name, pairs in ratios.items():
        for what, values in zip(("shortest", "median"), zip(*pairs, strict=True), strict=False):
            spread = f"{min(values):.2f} to {max(values):.2f}"
            print(f"{name} over other, {what}: {statistics.median(values):.2f} ({spread})")


if __name__ == "__main__":
    main()
