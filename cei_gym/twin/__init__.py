"""A twin of a recording: a scene built from what cameras saw and what the source did, in which motions are tried (`Twin`)."""

from cei_gym.twin.evidence import Evidence
from cei_gym.twin.options import TwinOptions
from cei_gym.twin.twin import Twin

__all__ = ["Evidence", "Twin", "TwinOptions"]
