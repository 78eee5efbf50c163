"""Training cubes (`pix2hdr dataset`): memory-mapped shards, seeded random crops, one prefetching thread."""

import hashlib
import json
import queue
import threading
from dataclasses import dataclass
from math import gcd, lcm
from pathlib import Path

import numpy as np
import torch

from .layout import granularity
from .pattern import ExposureTable
from .response import InverseResponse

FORMAT = "pix2hdr-dataset/1"


class DatasetError(ValueError):
    """A data set that cannot be used; the message names the file."""


@dataclass
class Batch:
    """y and e as [N, frames, H, W] (e may have N = 1), p as [N, hop, H, W]; float32."""

    measurement: torch.Tensor
    exposure: torch.Tensor
    truth: torch.Tensor

    def to(self, device) -> "Batch":
        """The same on a device."""
        return Batch(self.measurement.to(device), self.exposure.to(device), self.truth.to(device))


@dataclass(frozen=True)
class Pose:
    """A recording seen so that the camera's pattern looks the same: t, y and x run forwards from `shift` or backwards from
    `shift` − 1."""

    backwards: tuple[bool, bool, bool] = (False, False, False)
    shift: tuple[int, int, int] = (0, 0, 0)

    def keeps_time(self, schedule: int, frames: int, period: int) -> bool:
        """Whether a window of `frames` from a schedule time on lies in the pose where it lies in the recording."""
        first = self.shift[0] - schedule - frames if self.backwards[0] else schedule - self.shift[0]
        return (first - schedule) % period == 0

    def turn(self, video: np.ndarray) -> np.ndarray:
        """A video [t, y, x] with the axes backwards that are so in the pose."""
        return np.ascontiguousarray(video[tuple(slice(None, None, -1 if axis else 1) for axis in self.backwards)])


class Dataset:
    """A folder of cubes: `truth` f16 [n,t,y,x] irradiance, `measurement` u16 [n,t,y,x] counts."""

    def __init__(self, folder):
        self.folder = Path(folder)
        path = self.folder / "dataset.json"
        try:
            text = path.read_bytes()
            meta = json.loads(text)
        except (OSError, ValueError) as error:
            raise DatasetError(f"{path}: {error}") from error
        if meta.get("format") != FORMAT:
            raise DatasetError(f"{path}: format is {meta.get('format')!r}, not {FORMAT!r}")
        try:
            self.table = ExposureTable.of(meta)
            self.inverse = InverseResponse(meta["inverse_response"])
            self.frames, self.height, self.width = meta["frames"], meta["height"], meta["width"]
            self.schedule_start = meta["schedule_start"]
            self.white = float(2 ** meta["bit_depth"] - 1)
            self.black = float(meta.get("black_level", 0))  # a pedestal, if there is one
            shards = meta["shards"]
            saturation = float(meta["saturation"])
            # Data sets of older versions name none.
            self.poses = [Pose(**pose) for pose in meta.get("symmetries", [])] or [Pose()]
        except (KeyError, TypeError, ValueError) as error:
            raise DatasetError(f"{path}: {type(error).__name__}: {error}") from error
        if not np.isclose(saturation, self.inverse.saturation, rtol=1e-6):
            raise DatasetError(f"{path}: `saturation` is not the last entry of `inverse_response`")
        self.meta = meta
        self.digest = hashlib.sha256(text).hexdigest()
        self.shards = []
        self.index: list[tuple[int, int]] = []
        for number, shard in enumerate(shards):
            expected = (shard["cubes"], self.frames, self.height, self.width)
            arrays = []
            for key, kind in (("truth", np.float16), ("measurement", np.uint16)):
                file = self.folder / shard[key]
                try:
                    array = np.load(file, mmap_mode="r")
                except (OSError, ValueError) as error:
                    raise DatasetError(f"{file}: {error}") from error
                if array.shape != expected or array.dtype != kind:
                    raise DatasetError(f"{file}: {array.dtype} {array.shape}, expected {np.dtype(kind)} {expected}")
                arrays.append(array)
            info_file = self.folder / shard["info"]
            try:
                info = json.loads(info_file.read_text())
            except (OSError, ValueError) as error:
                raise DatasetError(f"{info_file}: {error}") from error
            if len(info) != shard["cubes"]:
                raise DatasetError(f"{info_file}: {len(info)} entries for {shard['cubes']} cubes")
            self.shards.append((*arrays, info))
            self.index += [(number, i) for i in range(shard["cubes"])]
        if not self.index:
            raise DatasetError(f"{path}: no cubes")

    def __len__(self) -> int:
        return len(self.index)

    def info(self, cube: int) -> dict:
        """What the simulator noted about a cube (kind, speed, noise, …)."""
        shard, i = self.index[cube]
        return self.shards[shard][2][i]

    def window_starts(self, window: dict, step: int | None = None) -> list[int]:
        """First frames of the windows in a cube: the first result frame's schedule time is a multiple of `step` (`hop`)."""
        starts = range(self.frames - window["frames"] + 1)
        return [s for s in starts if (self.schedule_start + s + window["lead"]) % (step or window["hop"]) == 0]

    def read(self, cube: int, window: dict, start: int, y0: int, x0: int, height: int, width: int):
        """(y [frames, H, W], p [hop, H, W]) of one window of one crop, float32."""
        shard, i = self.index[cube]
        truth, counts, _ = self.shards[shard]
        result = start + window["lead"]
        y, x = slice(y0, y0 + height), slice(x0, x0 + width)
        measurement = np.asarray(counts[i, start : start + window["frames"], y, x], np.float32) - np.float32(self.black)
        # Nets see pixel values in [0, 1], as the synthesis gives them.
        measurement = np.maximum(measurement / np.float32(self.white - self.black), 0.0)
        return measurement, np.asarray(truth[i, result : result + window["hop"], y, x], np.float32)

    def exposure(self, window: dict, start: int, height: int, width: int) -> np.ndarray:
        """e [frames, H, W] of a window; crops start at multiples of the tile, so one table serves all."""
        at = self.schedule_start + start
        return self.table.window(at, window["frames"], height, width).astype(np.float32)


def end_of_recording(measurement: np.ndarray, first: int, end: int, period: int) -> np.ndarray:
    """A window of which only frames `first` … `end` were recorded: the nearest of these at the same phase of the pattern
    stand in for the others, as in the synthesis."""
    t = np.arange(len(measurement))
    before = first + (t - first) % period
    behind = end - 1 - (end - 1 - t) % period
    return measurement[np.where(t < first, before, np.where(t >= end, behind, t))]


def miscalibrated(rng, measurement: np.ndarray, exposure: np.ndarray) -> np.ndarray:
    """y as a recording has it whose calibration is off: black level by up to 1.2% of white, gain by about 1% for each
    exposure on its own, and half of the times eight bits. Saturated pixels stay so."""
    error = float(np.exp(rng.uniform(np.log(0.001), np.log(0.012)))) * rng.choice((-1.0, 1.0))
    y = measurement * (1.0 + 0.01 * _of_each_exposure(rng, exposure)) + error
    return _recorded(rng, y, measurement)


def with_fixed_pattern(rng, measurement: np.ndarray, exposure: np.ndarray, tile: tuple[int, int]) -> np.ndarray:
    """y as a recording has it whose pixels differ, a little or much; lossy video leaves such differences too.

    At most, gains differ by about 1% from pixel to pixel, 3% between the positions of the tile, 2% between exposures; the
    black level is off by 1.2% of white, by about 0.3% in each pixel and 0.6% at each position. Half of the times eight
    bits. Saturated pixels stay so.
    """
    much = rng.random()
    frame = measurement.shape[1:]

    def of_each_position() -> np.ndarray:
        repeats = [-(-size // step) for size, step in zip(frame, tile, strict=True)]
        return np.tile(rng.standard_normal(tile), repeats)[: frame[0], : frame[1]]

    gain = 0.01 * rng.standard_normal(frame) + 0.03 * of_each_position() + 0.02 * _of_each_exposure(rng, exposure)
    black = 0.012 * rng.choice((-1.0, 1.0)) + 0.003 * rng.standard_normal(frame) + 0.006 * of_each_position()
    return _recorded(rng, measurement * (1.0 + much * gain) + much * black, measurement)


def _of_each_exposure(rng, exposure: np.ndarray) -> np.ndarray:
    """A standard normal number for each exposure, where it is."""
    exposures, which = np.unique(exposure, return_inverse=True)
    return rng.standard_normal(len(exposures))[which].reshape(exposure.shape)


def _recorded(rng, y: np.ndarray, measurement: np.ndarray) -> np.ndarray:
    """Disturbed values as a recording holds them: in range, half of the times in eight bits, saturated where they were."""
    y = np.where(measurement >= 0.999, measurement, np.clip(y, 0.0, 1.0))
    return (np.rint(y * 255.0) / 255.0 if rng.random() < 0.5 else y).astype(np.float32)


class Crops:
    """Batch number `step` of a seed is always the same batch, so resuming needs nothing but the step.

    Each is seen in one of the poses in which the camera's pattern looks the same. A share `ends` of the crops lies at the
    beginning or end of a recording, a share `off` is `miscalibrated` (30% if not said otherwise) or, if `fixed_pattern`,
    `with_fixed_pattern` (half).
    """

    def __init__(
        self,
        dataset: Dataset,
        graph: dict,
        batch: int,
        crop: int,
        seed: int,
        *,
        ends: float = 0.5,
        off: float | None = None,
        fixed_pattern: bool = False,
    ):
        self.dataset, self.window = dataset, graph["window"]
        self.batch, self.crop, self.seed = batch, crop, seed
        self.ends, self.fixed_pattern = ends, fixed_pattern
        self.off = (0.5 if fixed_pattern else 0.3) if off is None else off
        rows, columns = granularity(graph)
        # Crops must begin where a block and a tile begin.
        self.step_y, self.step_x = lcm(rows, dataset.table.tile[0]), lcm(columns, dataset.table.tile[1])
        if crop % rows or crop % columns:
            raise DatasetError(f"crop {crop}: must be a multiple of the graph's granularity {rows}×{columns}")
        if crop > min(dataset.height, dataset.width):
            raise DatasetError(f"crop {crop}: the cubes are only {dataset.height}×{dataset.width}")
        # All places in the pattern's period at which windows begin in a recording.
        self.starts = dataset.window_starts(self.window, gcd(self.window["hop"], dataset.table.period))
        if not self.starts:
            raise DatasetError(f"{dataset.folder}: cubes of {dataset.frames} frames hold no window of this graph")
        phases = {(dataset.schedule_start + s) % dataset.table.period for s in self.starts}
        self.exposures = {s: dataset.exposure(self.window, s, crop, crop) for s in self.starts}
        still = all(np.array_equal(e, self.exposures[self.starts[0]]) for e in self.exposures.values())
        self.one_exposure = len(phases) == 1 or still
        self.poses = {s: self._poses(dataset.schedule_start + s) for s in self.starts}

    def _poses(self, schedule: int) -> list[Pose]:
        """The poses that a window from a schedule time on can be shown in, and its result with it."""
        frames, lead, hop = self.window["frames"], self.window["lead"], self.window["hop"]
        table = self.dataset.table
        # A pose begins up to a tile later.
        small = self.crop + max(table.tile) > min(self.dataset.height, self.dataset.width)

        def fits(pose: Pose) -> bool:
            inside = not (small and any(pose.shift[1:]))
            result = not pose.backwards[0] or frames - hop == 2 * lead
            return inside and result and pose.keeps_time(schedule, frames, table.period)

        return [pose for pose in self.dataset.poses if fits(pose)]

    def _corner(self, rng, axis: int, size: int, step: int, pose: Pose) -> int:
        """Where a crop begins along y or x, so that the pose of it begins where a tile does."""
        shift = pose.shift[axis] % self.dataset.table.tile[axis - 1]
        return step * int(rng.integers((size - self.crop - shift) // step + 1)) + shift

    def __call__(self, step: int) -> Batch:
        rng = np.random.default_rng([self.seed, step])
        data, crop = self.dataset, self.crop
        pairs, starts = [], []
        for _ in range(self.batch):
            cube = int(rng.integers(len(data)))
            start = self.starts[int(rng.integers(len(self.starts)))]
            pose = self.poses[start][int(rng.integers(len(self.poses[start])))]
            y0 = self._corner(rng, 1, data.height, self.step_y, pose)
            x0 = self._corner(rng, 2, data.width, self.step_x, pose)
            measurement, truth = map(pose.turn, data.read(cube, self.window, start, y0, x0, crop, crop))
            if rng.random() < self.off:
                exposure = self.exposures[start]
                if self.fixed_pattern:
                    measurement = with_fixed_pattern(rng, measurement, exposure, data.table.tile)
                else:
                    measurement = miscalibrated(rng, measurement, exposure)
            pairs.append((self._end(rng, measurement), truth))
            starts.append(start)
        exposure = np.stack([self.exposures[s] for s in (starts[:1] if self.one_exposure else starts)])
        return Batch(
            torch.from_numpy(np.stack([m for m, _ in pairs])),
            torch.from_numpy(exposure),
            torch.from_numpy(np.stack([t for _, t in pairs])),
        )

    def _end(self, rng, measurement: np.ndarray) -> np.ndarray:
        """Now and then, frames before or behind the result count as not recorded."""
        frames, lead, period = self.window["frames"], self.window["lead"], self.dataset.table.period
        result = lead + self.window["hop"]
        if rng.random() >= self.ends or self.window["hop"] < period:
            return measurement
        if rng.random() < 0.5:
            return end_of_recording(measurement, int(rng.integers(0, lead + 1)), frames, period)
        return end_of_recording(measurement, 0, int(rng.integers(result, frames + 1)), period)


class Prefetch:
    """Batches first, first + 1, … made ahead in one thread; a failure there is raised here."""

    def __init__(self, crops: Crops, first: int, depth: int = 3):
        self._queue: queue.Queue = queue.Queue(depth)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, args=(crops, first), daemon=True)
        self._thread.start()

    def _work(self, crops: Crops, step: int) -> None:
        while not self._stop.is_set():
            try:
                item = crops(step)
            except Exception as error:  # handed to the consumer, which raises it
                item = error
            while not self._stop.is_set():
                try:
                    self._queue.put(item, timeout=0.2)
                    break
                except queue.Full:
                    continue
            if isinstance(item, Exception):
                return
            step += 1

    def __next__(self) -> Batch:
        item = self._queue.get()
        if isinstance(item, Exception):
            raise item
        return item

    def close(self) -> None:
        """Ends the thread."""
        self._stop.set()
        self._thread.join()
