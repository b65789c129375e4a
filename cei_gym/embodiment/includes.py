"""MJCF with its includes written in place, so that MuJoCo opens no file."""

from pathlib import Path
from xml.etree.ElementTree import Element

from cei_gym.embodiment.resources import Place, read_file
from cei_gym.errors import CEIError
from cei_gym.untrusted_xml import MAX_BYTES, MAX_DEPTH, MAX_ELEMENTS, load_xml

_MOST_FILES = 200


class Document:
    """A whole MJCF, its includes in place.

    Args:
        tree: its root as it is in the file; changed.
        place: where that is.

    Raises:
        CEIError: a file is missing, outside the root, included twice, or no XML; or all of it is too large.
    """

    def __init__(self, tree: Element, place: Place) -> None:
        self.tree = tree
        self._place = place
        self._read = {place.path}
        self._folders: dict[Element, Path] = {}
        self._elements = 0
        self._inline(tree, place.path.parent, 1)

    def find(self, element: Element, folder: str, file: str) -> Path:
        """The file that an element names, where MuJoCo would look: in a folder beside the main file, else beside the included one.

        Raises:
            CEIError: it is outside the root.
        """
        main = self._place.path.parent
        places = [main / folder / file]
        if element in self._folders:
            places.append(self._folders[element] / file)
        found = [self._place.inside(place, file) for place in places]
        return next((path for path in found if path.is_file()), found[0])

    def _inline(self, parent: Element, folder: Path, depth: int) -> None:
        self._elements += 1
        if depth > MAX_DEPTH or self._elements > MAX_ELEMENTS:
            raise CEIError(
                f"with its includes it has more than {MAX_ELEMENTS} elements, or {MAX_DEPTH} inside each other."
            )
        if folder != self._place.path.parent:
            self._folders[parent] = folder
        children: list[Element] = []
        for child in list(parent):
            if child.tag == "include":
                content, where = self._included(child, folder)
                self._inline(content, where, depth)
                children += list(content)
            else:
                self._inline(child, folder, depth + 1)
                children.append(child)
        parent[:] = children

    def _included(self, element: Element, folder: Path) -> tuple[Element, Path]:
        name = element.get("file", "")
        if len(element):
            raise CEIError(f"<include file={name[:60]!r}> has elements inside it; put them beside it.")
        places = [self._place.inside(at / name, name) for at in (self._place.path.parent, folder)]
        path = next((place for place in places if place.is_file()), places[0])
        if path in self._read or len(self._read) >= _MOST_FILES:
            raise CEIError(f"{name!r} is included twice, or there are more than {_MOST_FILES} includes.")
        self._read.add(path)
        content = read_file(path, name, MAX_BYTES)
        try:
            return load_xml(content), path.parent
        except CEIError as error:
            raise CEIError(f"{name}: {error}.") from None
