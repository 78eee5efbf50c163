"""Losses. Video tensors are [N, T, H, W]; `log_mse`, `charbonnier` and `l1` work on tone-mapped values l.

The paper's loss (eq. 16–20) is L_MSE + L_perc + L_SSIM.
"""

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from .tone import LOG_SCALE, MU


def log_mse(estimate: Tensor, truth: Tensor, floor: float = 1e-6) -> Tensor:
    """Mean over the batch of log10(mse + floor): minus a tenth of the mean PSNR-µ in dB."""
    mse = (estimate - truth).square().mean(dim=(1, 2, 3))
    return torch.log10(mse + floor).mean()


def charbonnier(estimate: Tensor, truth: Tensor, epsilon: float = 1e-3) -> Tensor:
    """Mean of √(d² + ε²) − ε."""
    return ((estimate - truth).square() + epsilon**2).sqrt().mean() - epsilon


def l1(estimate: Tensor, truth: Tensor) -> Tensor:
    """Mean of |d|."""
    return (estimate - truth).abs().mean()


def log_pattern_mse(estimate: Tensor, truth: Tensor, tile: tuple[int, int], floor: float = 1e-8) -> Tensor:
    """Mean over the batch of log10(mse + floor) of what of the error repeats with the pattern's tile.

    That is the error's mean over time and 4×4 tiles at each position of the tile, less the mean of all positions there.
    """
    rows, columns = tile
    error = (estimate - truth).mean(1)
    h, w = (size // (4 * step) for size, step in zip(error.shape[1:], tile, strict=True))
    error = error[:, : 4 * rows * h, : 4 * columns * w].reshape(-1, h, 4, rows, w, 4, columns).mean((2, 5))
    mse = (error - error.mean((2, 4), keepdim=True)).square().mean((1, 2, 3, 4))
    return torch.log10(mse + floor).mean()


SIMPLE = {"log_mse": log_mse, "charbonnier": charbonnier, "l1": l1}


def medium_tone(irradiance: Tensor, exposure: float) -> Tensor:
    """Eq. 24: ln(1 + e·µ·p) / ln(1 + µ) with e the medium exposure."""
    return torch.log1p(irradiance * (exposure * MU)) / LOG_SCALE


def mean_ssim(a: Tensor, b: Tensor) -> Tensor:
    """Eq. 18 and 19: mean SSIM of [N, H, W] images; Gaussian window 11, σ = 1.5, without padding."""
    window = torch.exp(-((torch.arange(11, dtype=a.dtype, device=a.device) - 5) ** 2) / (2 * 1.5**2))
    window = window / window.sum()

    def blur(x: Tensor) -> Tensor:
        return F.conv2d(F.conv2d(x, window.view(1, 1, 1, -1)), window.view(1, 1, -1, 1))

    a, b = a.unsqueeze(1), b.unsqueeze(1)
    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2
    covariance = blur(a * b) - mean_a * mean_b
    c1, c2 = 1e-4, 9e-4
    ssim = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    return (ssim / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))).mean()


class Vgg:
    """VGG16 up to relu2_2 (k = 8) on grey images in [0, 1], from an npz of ImageNet weights [out, in, ky, kx].

    Input as Keras and Caffe have it: BGR (three times the grey value), 0–255, channel means subtracted.
    """

    _LAYERS = ("conv1_1", "conv1_2", "conv2_1", "conv2_2")

    def __init__(self, path):
        with np.load(path) as file:
            missing = [f"{n}.{k}" for n in self._LAYERS for k in ("weight", "bias") if f"{n}.{k}" not in file]
            if missing:
                raise ValueError(f"{path}: no {missing[0]}")
            pairs = [(torch.from_numpy(file[f"{n}.weight"]), torch.from_numpy(file[f"{n}.bias"])) for n in self._LAYERS]
        self.layers = pairs
        self.mean = torch.tensor([103.939, 116.779, 123.68]).view(1, 3, 1, 1)

    def to(self, device) -> "Vgg":
        """Moves the weights to a device."""
        self.layers = [(w.to(device), b.to(device)) for w, b in self.layers]
        self.mean = self.mean.to(device)
        return self

    def features(self, images: Tensor) -> Tensor:
        """relu2_2 of [N, H, W], in units of the 0–1 input (divided by 255, so that it weighs like L_MSE)."""
        x = images.unsqueeze(1) * 255.0 - self.mean
        for i, (weight, bias) in enumerate(self.layers):
            if i == 2:
                x = F.max_pool2d(x, 2)
            x = F.relu(F.conv2d(x, weight, bias, padding=1))
        return x / 255.0


class PaperLoss:
    """Eq. 16: L_MSE + w·L_perc + L_SSIM on [N, T, H, W] in about [0, 1]."""

    def __init__(self, vgg: Vgg, perceptual_weight: float = 1.0, perceptual_frames: int = 0):
        self.vgg, self.weight, self.frames = vgg, perceptual_weight, perceptual_frames

    def __call__(self, estimate: Tensor, truth: Tensor) -> Tensor:
        images, targets = estimate.flatten(0, 1), truth.flatten(0, 1)
        loss = F.mse_loss(images, targets) + 1.0 - mean_ssim(images, targets)
        if self.weight == 0:
            return loss
        if self.frames and self.frames < estimate.shape[1]:
            # The perceptual term on evenly spread frames only: it costs more than everything else.
            pick = torch.linspace(0, estimate.shape[1] - 1, self.frames).round().long()
            images, targets = estimate[:, pick].flatten(0, 1), truth[:, pick].flatten(0, 1)
        with torch.no_grad():
            wanted = self.vgg.features(targets)
        return loss + self.weight * F.l1_loss(self.vgg.features(images), wanted)
