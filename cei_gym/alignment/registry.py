"""Which solvers there are, by name; nothing of theirs is imported."""

from collections.abc import Mapping
from types import MappingProxyType

from cei_gym import plugins

GROUP = "cei_gym.solvers"
"""Entry points by which packages offer their own."""
DEFAULT_SOLVER = "numba"
OWN: Mapping[str, str] = MappingProxyType(
    {
        "numba": "cei_gym.alignment.solvers.newton:NewtonSolver",
        "torch": "cei_gym.alignment.solvers.newton_torch:TorchNewtonSolver",
        "paper": "cei_gym.alignment.solvers.paper:PaperSolver",
    }
)
"""Where ours are; those that need torch take seconds to import."""


def solver_names() -> tuple[str, ...]:
    """Names of all solvers, ours first; one that a package offers under a name of ours is not used.

    Raises:
        CEIError: two packages offer different ones under one name.
    """
    return *OWN, *(name for name in plugins.offered(GROUP) if name not in OWN)
