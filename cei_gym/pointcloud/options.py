"""What a synthesised cloud is like."""

from dataclasses import dataclass

from cei_gym.errors import CEIError

_MOST_POINTS = 10_000_000


@dataclass(frozen=True)
class CloudOptions:
    """Options of synthesised clouds; the converter and `CrossEmbodimentWrapper` must agree on them.

    Attributes:
        swap: put the target in the place of the source; False keeps clouds as cameras see them (the paper's ablation without
            augmentation).
        points: of a cloud (the paper's 1024).
        robot_share: at most this share of a cloud shows the robot that is put in, where there are enough other points: its joints say
            where it is, nothing else says where a small object is. null thins all points alike, as the paper does: of 1024, a hand and
            its arm then take some 800.
        robot_points: sampled over the whole surface of the robot that is put in; of those that lie in the workspace, at most twice
            `points` are drawn for thinning.
        tau_m: points within this distance of the surface of the robot that is taken out are removed (the paper's 5 mm).
        voxel_m: before thinning, keep one point a cell of this edge; 0 keeps all, as the paper does.
        outlier_m: drop recorded points with fewer than three others within this distance (30 mm for real cameras: farthest-point
            thinning picks outliers first); 0 keeps them.
        seen_only: put in only those points of the robot that the scene's cameras would see.
        colours: keep colours where they are recorded: points are then x, y, z in m and r, g, b in [0, 1].
        seed: of sampling and thinning.
    """

    swap: bool = True
    points: int = 1024
    robot_share: float | None = None
    robot_points: int = 16384
    tau_m: float = 0.005
    voxel_m: float = 0.0
    outlier_m: float = 0.0
    seen_only: bool = False
    colours: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("points", "robot_points"):
            if getattr(self, name) < 1:
                raise CEIError(f"clouds.{name}={getattr(self, name)} must be at least 1.")
            if getattr(self, name) > _MOST_POINTS:
                raise CEIError(f"clouds.{name}={getattr(self, name)} must be at most {_MOST_POINTS}.")
        if self.robot_share is not None and not 0 < self.robot_share < 1:
            raise CEIError(f"clouds.robot_share={self.robot_share} must be between 0 and 1, or null.")
        if self.seed < 0:
            raise CEIError(f"clouds.seed={self.seed} must be at least 0.")
        if not 0 < self.tau_m < float("inf"):
            raise CEIError(f"clouds.tau_m={self.tau_m} must be positive and finite.")
        for name in ("voxel_m", "outlier_m"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise CEIError(f"clouds.{name}={getattr(self, name)} must be at least 0 and finite.")
