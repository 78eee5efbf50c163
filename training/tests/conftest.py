"""Shared fixtures: a fake data set, linear and curved, made once."""

import numpy as np
import pytest
import torch
from fake_data import make_dataset

torch.set_num_threads(2)


@pytest.fixture(scope="session")
def data_folder(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("data") / "linear", cubes=4, size=32)


@pytest.fixture(scope="session")
def curved_folder(tmp_path_factory):
    y = np.linspace(0, 1, 1025)
    return make_dataset(tmp_path_factory.mktemp("data") / "curved", cubes=2, size=16, table=2 * (0.6 * y + 0.4 * y**3))
