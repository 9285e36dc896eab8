"""What the documentation site has beyond the files of docs: MkDocs calls the functions ``on_...``."""

import ast
import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pymdownx.slugs import slugify

from frog_blender.engine.options import OPTIONS
from frog_blender.engine.recipes import Recipe
from frog_blender.engine.setting import meanings_of, text_of

ROOT = Path(__file__).resolve().parents[1]
ENGINE = ROOT / "frog_blender" / "engine" / "__init__.py"
STYLE = """
/* Names stay whole; a phone scrolls the table. */
td:not(.doc td, :last-child):has(code) { min-width: 9rem; }
.md-typeset figure, figure img { width: 100%; }
"""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Anchors of headings as GitHub makes them, which the pages' links are written for."""
    config.mdx_configs["toc"]["slugify"] = slugify(case="lower")
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the reference of the Python API, from its docstrings, and the style."""
    files.append(File.generated(config, "reference.md", content=reference()))
    files.append(File.generated(config, "site.css", content=STYLE))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """What GitHub's Markdown writes otherwise, and links that leave the site."""
    if page.file.src_uri.endswith("/tables.md"):
        page.meta["search"] = {"exclude": True}
    return in_table_code(without_links_out(markdown, page.file.src_uri))


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """A picture opens at its full size, and what it is called stands below it."""
    figure = r'<figure><a href="\3">\1</a><figcaption>\2</figcaption></figure>'
    return re.sub(r'<p>(<img alt="([^"]*)" src="([^"]*)" ?/?>)</p>', figure, html)


def in_table_code(markdown: str) -> str:
    r"""In a table GitHub takes ``\|`` for a bar within code, where MkDocs needs no backslash."""
    return re.sub(r"`[^`\n]*`", lambda code: code[0].replace(r"\|", "|"), markdown)


def without_links_out(markdown: str, page: str) -> str:
    """Links from a page (its path in docs) to what lies outside docs become their text."""

    def kept(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(page), link[2]))
        return link[1] if target.startswith("..") else link[0]

    return re.sub(r"\[([^\]\n]+)\]\((\.\./[^)\n]+)\)", kept, markdown)


def reference() -> str:
    """Everything public, in its own order, as mkdocstrings reads it."""
    tree = ast.parse(ENGINE.read_text(encoding="utf-8"))
    public = next(
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
    )
    homes = {
        name.name: f"frog_blender.engine.{node.module}.{name.name}"
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.level
        for name in node.names
    }
    defaults = {name: text_of(getattr(Recipe(), name)) or "none" for name in meanings_of(Recipe)}
    settings = [
        (name, f"{of.help}: {of.kind.expected}; default: {defaults[name]}") for name, of in meanings_of(Recipe).items()
    ]
    more = {
        "Recipe": table("setting", settings),
        "train": table("option", [(option.name, option.described) for option in OPTIONS.values()]),
    }
    return "\n\n".join(["# Reference", *(f"::: {homes[name]}\n\n{more.get(name, '')}".rstrip() for name in public)])


def table(kind: str, rows: list[tuple[str, str]]) -> str:
    """Names and meanings, as Markdown."""
    return "\n".join([f"| {kind} | meaning |", "|---|---|", *(f"| `{name}` | {what} |" for name, what in rows)])
