"""Options of refinement by rollouts."""

from dataclasses import dataclass, fields

from cei_converters.cli.options import check_range
from cei_gym.errors import CEIError


@dataclass
class RefineOptions:
    """Refinement by rollouts; `--refine` switches it on.

    Attributes:
        enabled: where an episode fails in its environment, or holds by luck, search a correction of how it takes hold.
        perturbed: slightly different replays by which each way is judged, and as many others that confirm what is chosen.
        robust: share of replays that is enough.
        replays: most that are spent on an episode; what holds best by then is kept.
        population: corrections of each generation.
        starts: most that are tried for all episodes alike, by a few of them, before a correction is searched; 1 for none but what follows best.
        generations: most that are spent on a correction for all episodes alike, by a few of them, before each is looked at; 0 for none.
        seed: of what is drawn.
    """

    enabled: bool = False
    perturbed: int = 4
    robust: float = 0.8
    replays: int = 120
    population: int = 6
    starts: int = 16
    generations: int = 6
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (
            ("perturbed", 1),
            ("replays", 1),
            ("population", 2),
            ("starts", 1),
            ("generations", 0),
            ("seed", 0),
        ):
            check_range(f"--refine.{name}", getattr(self, name), least)
        if not 0 < self.robust <= 1:
            raise CEIError(f"refine.robust={self.robust} must be over 0, and at most 1.")
        others = [field.name for field in fields(self) if getattr(self, field.name) != field.default]
        if not self.enabled and others:
            raise CEIError(f"--refine.{others[0]} is of no use without --refine.")
