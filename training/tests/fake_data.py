"""A tiny data set in the format of `pix2hdr dataset`, made with NumPy alone: smooth moving patterns."""

import json

import numpy as np

from pix2hdr_training.pattern import exposure_table


def make_dataset(folder, *, cubes=4, frames=40, size=32, pattern="mpve-1-4", start=4, seed=0, table=None):
    """Writes two shards; `table` is the inverse response (default: linear)."""
    rng = np.random.default_rng(seed)
    camera = exposure_table(pattern)
    if table is None:
        table = np.linspace(0, camera.saturation, 1025)
    folder.mkdir(parents=True, exist_ok=True)
    longest = int(camera.exposures.max())
    shards = []
    for shard in range(2):
        n = cubes // 2
        truth = np.stack([_movie(rng, frames + 2 * longest, size) for _ in range(n)])
        counts = np.stack([_expose(movie, camera, start - longest, np.asarray(table), rng) for movie in truth])
        names = {key: f"{key}-{shard:03}.npy" for key in ("truth", "measurement")}
        np.save(folder / names["truth"], truth[:, longest : longest + frames].astype(np.float16))
        np.save(folder / names["measurement"], counts[:, longest : longest + frames])
        info = [{"kind": "pan" if i % 2 else "static", "speed": 1.0} for i in range(n)]
        (folder / f"info-{shard:03}.json").write_text(json.dumps(info))
        shards.append({**names, "info": f"info-{shard:03}.json", "cubes": n})
    meta = {
        "format": "pix2hdr-dataset/1",
        "pattern": pattern,
        "period": camera.period,
        "rows": camera.tile[0],
        "cols": camera.tile[1],
        "exposures": camera.exposures.ravel().tolist(),
        "saturation": camera.saturation,
        "inverse_response": list(map(float, table)),
        "bit_depth": 10,
        "schedule_start": start,
        "cubes": cubes,
        "frames": frames,
        "height": size,
        "width": size,
        "seed": seed,
        "shards": shards,
    }
    (folder / "dataset.json").write_text(json.dumps(meta))
    return folder


def _movie(rng, frames, size):
    t, y, x = np.meshgrid(np.arange(frames), np.arange(size), np.arange(size), indexing="ij")
    value = np.zeros(t.shape)
    for _ in range(5):
        fy, fx, ft = rng.uniform(-0.6, 0.6, 2).tolist() + [rng.uniform(-0.3, 0.3)]
        value += rng.uniform(0.2, 1) * np.sin(fy * y + fx * x + ft * t + rng.uniform(0, 6))
    return np.clip(np.exp(value - 2), 0, 1)


def _expose(movie, camera, start, table, rng):
    """Every frame holds the read-out that covers it; phases as multiples of half the longest exposure do not matter."""
    frames, height, width = movie.shape
    exposures = camera.window(0, 1, height, width)[0].astype(int)
    counts = np.zeros(movie.shape, np.uint16)
    levels = np.linspace(0, 1, len(table))
    for e in np.unique(exposures):
        phase = start % e
        for begin in range(-phase, frames, e):
            low, high = max(begin, 0), min(begin + e, frames)
            x = movie[low:high].sum(0) * e / (high - low)
            y = np.interp(x, table, levels) + rng.normal(0, 2e-3, x.shape)
            value = np.rint(np.clip(y, 0, 1) * 1023).astype(np.uint16)
            counts[low:high] = np.where(exposures == e, value, counts[low:high])
    return counts
