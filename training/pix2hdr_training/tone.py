"""The tone curve of training and measures: l(p) = ln(1 + µ p) / ln(1 + µ), µ = 5000."""

import math

import torch
from torch import Tensor

MU = 5000.0
LOG_SCALE = math.log1p(MU)


def tone(irradiance: Tensor) -> Tensor:
    """l(p); irradiance must be above −1/µ."""
    return torch.log1p(irradiance * MU) / LOG_SCALE


def inverse_tone(value: Tensor) -> Tensor:
    """l⁻¹(v)."""
    return torch.expm1(value * LOG_SCALE) / MU


def psnr_mu(mse: float) -> float:
    """PSNR (dB) of l with peak 1; a perfect picture is reported as 100 dB."""
    return -10.0 * math.log10(max(mse, 1e-10))
