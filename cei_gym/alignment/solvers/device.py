"""Where torch computes: the devices by name, and the precision that each has."""

import torch

from cei_gym.errors import CEIError


def choose_device(name: str) -> torch.device:
    """The device of one of `SolverOptions`' names; "auto" is a CUDA device where there is one, else the CPU.

    Raises:
        CEIError: there is no such device here.
    """
    here = {"cpu": True, "cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
    if name == "auto":
        name = "cuda" if here["cuda"] else "cpu"
    if not here[name]:
        raise CEIError(f"solver.device={name}, but torch finds no such device here.")
    return torch.device(name)


def widest_real(device: torch.device) -> torch.dtype:
    """Double precision, where a device has it: "mps" has none."""
    return torch.float32 if device.type == "mps" else torch.float64
