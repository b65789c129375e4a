"""From a robot's description to its YAML: what it is made of, how it closes, where its pads are, and what of a YAML is wrong."""

from cei_gym.onboarding.check import Finding, check_arm, check_end_effector
from cei_gym.onboarding.propose import Proposal, propose

__all__ = ["Finding", "Proposal", "check_arm", "check_end_effector", "propose"]
