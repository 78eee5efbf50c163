"""Exposure tables of patterns.

Training takes a table from `dataset.json`, which the simulator wrote; what has no data set (golden files, tests) takes those
of the built-in patterns from `weights-format/golden-layouts`, which the simulator's code wrote too.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

BUILT_IN = Path(__file__).resolve().parents[2] / "weights-format" / "golden-layouts" / "patterns.json"


@dataclass(frozen=True)
class ExposureTable:
    """Exposure, in frames, of the read-out that covers frame t at pixel (y, x); periodic in all three axes."""

    exposures: np.ndarray  # [period, rows, cols], float64

    @classmethod
    def of(cls, description: dict) -> "ExposureTable":
        """The table of a description with `period`, `rows`, `cols` and `exposures`, row by row."""
        shape = (description["period"], description["rows"], description["cols"])
        return cls(np.asarray(description["exposures"], np.float64).reshape(shape))

    @property
    def period(self) -> int:
        """Period in frames of schedule time."""
        return self.exposures.shape[0]

    @property
    def tile(self) -> tuple[int, int]:
        """Rows and columns of the spatial tile."""
        return self.exposures.shape[1:]

    @property
    def saturation(self) -> float:
        """x_sat, the shortest exposure."""
        return float(self.exposures.min())

    def window(self, schedule_time: int, frames: int, height: int, width: int) -> np.ndarray:
        """e(t, y, x) as [frames, height, width] from a schedule time on, the origin at a tile's corner."""
        t = (schedule_time + np.arange(frames)) % self.period
        y = np.arange(height) % self.tile[0]
        x = np.arange(width) % self.tile[1]
        return self.exposures[np.ix_(t, y, x)]


def exposure_table(name: str) -> ExposureTable:
    """The table of a built-in pattern."""
    known = json.loads(BUILT_IN.read_text())
    if name not in known:
        raise ValueError(f"pattern {name!r} is not built in (known: {', '.join(known)})")
    return ExposureTable.of(known[name])
