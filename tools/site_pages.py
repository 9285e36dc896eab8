"""Pages of the documentation site that no file has: MkDocs calls ``on_files``."""

import ast
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
ENGINE = ROOT / "frog_blender" / "engine" / "__init__.py"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the reference of the Python API, from its docstrings."""
    files.append(File.generated(config, "reference.md", content=reference()))
    return files


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
    return "\n\n".join(["# Reference", *(f"::: {homes[name]}" for name in public)])
