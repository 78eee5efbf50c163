"""The loss curve of a run: `curve.csv`, `scores.csv` and a small `curve.png`."""

import csv
import struct
import zlib
from pathlib import Path

import numpy as np

from .export import write_atomically

COLUMNS = ("step", "seconds", "loss", "lr")
SCORE_COLUMNS = ("step", "seconds", "psnr_mu", "box_psnr_mu", "gain_db")


class Curve:
    """Appends rows as training goes on; rows behind the step that a run resumes from are dropped."""

    def __init__(self, folder: Path, keep_until: int):
        self.folder = folder
        self.loss, self.scores = folder / "curve.csv", folder / "scores.csv"
        for path, columns in ((self.loss, COLUMNS), (self.scores, SCORE_COLUMNS)):
            rows = [row for row in _read(path) if int(row["step"]) <= keep_until] if path.exists() else []
            with path.open("w", newline="") as file:
                writer = csv.DictWriter(file, columns, lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)

    def add(self, step: int, seconds: float, loss: float, lr: float) -> None:
        """One row of `curve.csv`."""
        _append(self.loss, (step, f"{seconds:.1f}", f"{loss:.6f}", f"{lr:.3e}"))

    def add_score(self, step: int, seconds: float, scores: dict) -> None:
        """One row of `scores.csv`."""
        values = (f"{scores[key]:.4f}" for key in SCORE_COLUMNS[2:])
        _append(self.scores, (step, f"{seconds:.1f}", *values))

    def draw(self) -> None:
        """`curve.png`: the loss over training time, left to right, from its least to its largest value."""
        rows = _read(self.loss)
        if len(rows) >= 2:
            points = [(float(r["seconds"]), float(r["loss"])) for r in rows]
            write_atomically(self.folder / "curve.png", png(plot(points)))


def _read(path: Path) -> list[dict]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def _append(path: Path, row) -> None:
    with path.open("a", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(row)


def plot(points: list[tuple[float, float]], width: int = 640, height: int = 320) -> np.ndarray:
    """A grey picture [height, width] with a line through the points and a grid of ten by five."""
    image = np.full((height, width), 255, np.uint8)
    image[np.linspace(0, height - 1, 6).astype(int), :] = 220
    image[:, np.linspace(0, width - 1, 11).astype(int)] = 220
    x, y = np.array(points, np.float64).T
    good = np.isfinite(y)
    x, y = x[good], y[good]
    if len(x) < 2 or x[-1] <= x[0]:
        return image
    span = max(float(y.max() - y.min()), 1e-12)
    columns = np.arange(width)
    values = np.interp(columns / (width - 1) * (x[-1] - x[0]) + x[0], x, y)
    rows = np.rint((y.max() - values) / span * (height - 1)).astype(int)
    for column in columns:
        before = rows[max(column - 1, 0)]
        low, high = sorted((before, rows[column]))
        image[low : high + 1, column] = 0
    return image


def png(image: np.ndarray) -> bytes:
    """An 8-bit grey PNG file."""
    height, width = image.shape

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    lines = b"".join(b"\0" + row.tobytes() for row in image)
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")
