"""What of cmaes is used here, typed: it comes without types."""

from cei_gym.arrays import Array

class CMA:
    def __init__(
        self,
        mean: Array,
        sigma: float,
        bounds: Array | None = ...,
        n_max_resampling: int = ...,
        seed: int | None = ...,
        population_size: int | None = ...,
    ) -> None: ...
    @property
    def population_size(self) -> int: ...
    def ask(self) -> Array: ...
    def tell(self, solutions: list[tuple[Array, float]]) -> None: ...
    def should_stop(self) -> bool: ...
