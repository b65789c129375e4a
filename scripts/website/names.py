"""Public names: those that the API pages list, and which of them say nothing of themselves."""

import re
from collections.abc import Iterator
from pathlib import Path

import griffe
from shared_entries import SharedEntries

PAGES = "docs/api"
SEARCHED = (".", "converters", "envs", "policies", "robots")
"""Where packages are, in a checkout."""


def listed(root: Path) -> dict[str, str]:
    """Dotted name to the page that lists it."""
    found: dict[str, str] = {}
    for page in sorted((root / PAGES).glob("*.md")):
        for name in re.findall(r"^::: ([\w.]+)", page.read_text(), re.MULTILINE):
            found[name] = page.relative_to(root).as_posix()
    return found


def complaints(root: Path) -> list[str]:
    """What is wrong with the names that are listed, a line each: there is none such, or it, a public member or a field is not documented."""
    names, said = listed(root), []
    packages = sorted({name.partition(".")[0] for name in names})
    extensions = griffe.load_extensions(SharedEntries)
    loader = griffe.GriffeLoader(extensions=extensions, search_paths=[root / each for each in SEARCHED])
    for package in packages:
        loader.load(package, try_relative_path=False)
    for name, page in names.items():
        try:
            found = loader.modules_collection[name]
            found = found.final_target if found.is_alias else found
        except (KeyError, griffe.GriffeError) as error:
            said.append(f"{page}: there is no {name} ({type(error).__name__}).")
            continue
        said += [f"{page}: {path} has no docstring." for path in undocumented(found, name)]
    return said


def undocumented(found: griffe.Object, name: str) -> Iterator[str]:
    """What says nothing of itself: the name, or a public member of the class that it is."""
    if not found.has_docstring:
        yield name
    if not found.is_class:
        return
    for member in found.members.values():
        if member.name.startswith("_") or member.is_alias or _is_set_by_a_method(found, member):
            continue
        if not _is_documented(found, member.name):
            yield f"{name}.{member.name}"


def _sections(found: griffe.Object) -> Iterator[list]:
    if found.docstring is None:
        return
    for section in found.docstring.parse("google", warnings=False):
        if section.kind in (griffe.DocstringSectionKind.attributes, griffe.DocstringSectionKind.parameters):
            yield section.value


def _is_documented(found: griffe.Class, name: str) -> bool:
    """Whether it, or a class that it is made from, says what a member is."""
    if name in found.members and found.members[name].has_docstring:
        return True
    if name in {entry.name for section in _sections(found) for entry in section}:
        return True
    return any(base.is_class and _is_documented(base, name) for base in found.resolved_bases)


def _is_set_by_a_method(found: griffe.Class, member: griffe.Object) -> bool:
    """What a method assigns is shown, and so public, if it is documented."""
    methods = [each for each in found.members.values() if each.is_function and not each.is_alias]
    return (
        member.is_attribute
        and not member.has_docstring
        and any(each.lineno < member.lineno <= each.endlineno for each in methods)
    )
