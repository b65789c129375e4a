"""Checks that hold for the elements of MJCF and URDF alike."""

from collections import Counter
from xml.etree.ElementTree import Element

from cei_gym.errors import CEIError

_MAX_NUMBER = 1e10  # MuJoCo's mjMAXVAL
_LONGEST_NAME = 200
_MOST = {
    **dict.fromkeys(("body", "link", "joint"), 1000),
    **dict.fromkeys(("geom", "visual", "collision", "mesh"), 2000),
    "site": 5000,
}
"""What one description may have of each: some ten times what the largest robots have."""
_SECTIONS = ("asset", "actuator", "tendon", "equality", "contact", "default")
_MOST_IN_A_SECTION = 4000


def check_counts(tree: Element) -> None:
    """Refuse what would take MuJoCo, or what comes after it, minutes.

    Raises:
        CEIError: there are too many elements of a kind.
    """
    count = Counter(element.tag for element in tree.iter())
    for element in tree.iter():
        if len(name := element.get("name", "")) > _LONGEST_NAME:
            raise CEIError(
                f"<{element.tag} name={name[:40]!r}...> has {len(name)} letters; {_LONGEST_NAME} are allowed."
            )
    for tag, most in _MOST.items():
        if count[tag] > most:
            raise CEIError(f"it has {count[tag]} <{tag}> elements; {most} are allowed.")
    for section in _SECTIONS:
        if (n := sum(map(len, tree.findall(section)))) > _MOST_IN_A_SECTION:
            raise CEIError(f"its <{section}> has {n} elements; {_MOST_IN_A_SECTION} are allowed.")


def check_numbers(tree: Element, may_be_infinite: tuple[str, ...] = ()) -> None:
    """Refuse numbers that MuJoCo's parser would choke on, or read without a word.

    Raises:
        CEIError: an attribute's number is not finite, or too large.
    """
    for element in tree.iter():
        for name, text in element.items():
            if name not in may_be_infinite and not _reasonable(text):
                raise CEIError(f"<{element.tag} {name}={text[:60]!r}> is not within {_MAX_NUMBER:g}.")


def _reasonable(text: str) -> bool:
    """Whether numbers, if the text is numbers, are ones that MuJoCo can work with."""
    try:
        return all(abs(float(part)) <= _MAX_NUMBER for part in text.split())
    except ValueError:
        return True
