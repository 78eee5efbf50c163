"""The inverse camera response R⁻¹ on pixel values y in [0, 1]."""

import numpy as np
import torch
from torch import Tensor


class InverseResponse:
    """R⁻¹ as a table, uniform in y over [0, 1], linearly interpolated.

    y at and above 1 gives x_sat (the table's last entry), y at and below 0 the first entry. A table of two
    entries, (0, x_sat), is the linear response.
    """

    def __init__(self, table):
        values = np.asarray(table, dtype=np.float64)
        if values.ndim != 1 or len(values) < 2:
            raise ValueError("inverse response: the table needs at least two entries")
        if not np.all(np.isfinite(values)) or np.any(np.diff(values) < 0) or values[-1] <= values[0]:
            raise ValueError("inverse response: the table must be finite and increasing")
        straight = np.linspace(values[0], values[-1], len(values))
        self.linear = bool(values[0] == 0.0 and np.allclose(values, straight, rtol=0, atol=1e-6 * values[-1]))
        self.saturation = float(values[-1])
        self.table = torch.from_numpy(values)
        self._cast: dict = {}

    @classmethod
    def of_linear(cls, saturation: float) -> "InverseResponse":
        """The linear response with R⁻¹(y) = y·x_sat."""
        return cls([0.0, saturation])

    def forward(self, x: Tensor) -> Tensor:
        """R: pixel values in [0, 1] for exposure values x, the exact inverse of the table."""
        table = self.table.to(dtype=x.dtype, device=x.device)
        x = x.clamp(self.table[0].item(), self.saturation).contiguous()
        index = torch.searchsorted(table, x, right=True).clamp(1, len(table) - 1) - 1
        low = table[index]
        step = (table[index + 1] - low).clamp(min=torch.finfo(x.dtype).tiny)
        return (index + (x - low) / step) / (len(table) - 1)

    def __call__(self, y: Tensor) -> Tensor:
        """Exposure value x in p·frames for pixel values y of any shape."""
        y = y.clamp(0.0, 1.0)
        if self.linear:
            return y * self.saturation
        key = (y.dtype, y.device)
        if key not in self._cast:
            self._cast[key] = self.table.to(dtype=y.dtype, device=y.device)
        table = self._cast[key]
        position = y * (len(table) - 1)
        index = position.detach().floor().clamp(max=len(table) - 2).long()
        low = table[index]
        return low + (position - index) * (table[index + 1] - low)
