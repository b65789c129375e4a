"""Names inside a model of arm and end-effector, and those outside it."""

END_EFFECTOR_PREFIX = "ee/"
"""Keeps an end-effector's names apart from its arm's inside one model; public joint names do not carry it."""


def public_name(name: str) -> str:
    """A link's or joint's name as its description has it."""
    return name.removeprefix(END_EFFECTOR_PREFIX)
