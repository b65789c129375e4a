"""What the site does beyond MkDocs: it takes documents from where they are, makes formulas readable without a network, and is strict about names."""

import html
import logging
import re

import commands
import names
import site_files
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

log = logging.getLogger("mkdocs.hooks.website")  # with --strict, a warning of it is an error


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Put the project's documents, pictures and results in the place of those of one folder."""
    ours = site_files.collect(config)
    for file in [*files]:
        if file.generated_by is None and file.src_dir == config.docs_dir:
            files.remove(file)
    for file in ours:
        files.append(file)
    for said in names.complaints(site_files.ROOT):
        log.warning(said)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to folders to the page that says what is in them, and say all options of the commands."""
    return commands.with_help(site_files.link_pages(markdown, page.file.src_uri, files))


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Write formulas as MathML, which browsers draw by themselves."""
    return re.sub(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', _formula, content, flags=re.DOTALL)


def _formula(found: re.Match[str]) -> str:
    return convert(html.unescape(found[2]), display="block" if found[1] == "div" else "inline")
