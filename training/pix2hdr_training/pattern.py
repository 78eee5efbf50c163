"""The exposure tables of the built-in MPVE patterns.

Training takes the table from `dataset.json`, which the simulator wrote; this module serves what has no data set
(golden files, tests).
"""

from dataclasses import dataclass

import numpy as np

# The four kinds of pixel, (exposure, phase), in the order of row 0; row 1 is the same rotated by two cells.
_KINDS = {
    "mpve-1-4": ((2, 1), (4, 2), (8, 0), (8, 4)),
    "mpve-1-8": ((2, 1), (4, 2), (8, 4), (16, 8)),
    "mpve-1-16": ((2, 1), (4, 2), (8, 4), (32, 16)),
}


@dataclass(frozen=True)
class ExposureTable:
    """Exposure, in frames, of the read-out that covers frame t at pixel (y, x); periodic in all three axes."""

    exposures: np.ndarray  # [period, rows, cols], float64

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
    """The table of a built-in pattern; every pixel of these keeps its exposure for good."""
    if name not in _KINDS:
        raise ValueError(f"pattern {name!r} is not built in here (known: {', '.join(_KINDS)})")
    kinds = _KINDS[name]
    rows = np.array([[e for e, _ in kinds], [e for e, _ in kinds[2:] + kinds[:2]]], dtype=np.float64)
    period = max(e for e, _ in kinds)
    return ExposureTable(np.repeat(rows[None], period, axis=0))
