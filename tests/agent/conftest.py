"""One thread: the networks here are small, and on a shared machine two take thirty times as long."""

import torch

torch.set_num_threads(1)
