"""Profiles and scenarios: a strict YAML file becomes one frozen model, or one sentence says why not."""

import json
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from companion.settings import Settings
from companion.yaml_problems import problems_of
from companion.yaml_tree import (
    MAX_BYTES,
    Entry,
    KeyPath,
    Mark,
    MissingProfileError,
    Node,
    Problem,
    RejectedProfileError,
    described,
    parse_tree,
    quoted,
    refuse,
)

MAX_EXTENDS = 8
EXTENDS = "extends"

_Model = TypeVar("_Model", bound=Settings)


def load(path: Path | str, model: type[_Model]) -> _Model:
    """Read a YAML file, with what it extends, as a settings model.

    Raises:
        MissingProfileError: if the file itself does not exist.
        RejectedProfileError: if anything in it is wrong; the text is
            ``file:line:column: key.path: what was found, what is allowed`` and `problems` lists all.
    """
    return validated(read_tree(Path(path)), model)


def loads(text: str | bytes, model: type[_Model], name: str = "text") -> _Model:
    """Read YAML text as a settings model; ``extends`` is refused, because there is no folder to look in.

    Raises:
        RejectedProfileError: if anything in it is wrong.
    """
    tree = parse_tree(text, name)
    assert isinstance(tree.value, dict)
    if EXTENDS in tree.value:
        raise refuse(tree.value[EXTENDS].key_mark, (EXTENDS,), "allowed in files only")
    return validated(tree, model)


def validated(tree: Node, model: type[_Model]) -> _Model:
    """Return the settings that a tree says.

    Raises:
        RejectedProfileError: if anything in it is wrong.
    """
    # JSON semantics let a strict model take a list as a tuple, a word as an enum and 3 as 3.0, no more.
    try:
        return model.model_validate_json(json.dumps(tree.plain()))
    except ValidationError as error:
        raise RejectedProfileError(problems_of(error, tree, model)) from None


def read_tree(path: Path) -> Node:
    """Read a YAML file and everything it extends.

    ``extends: other.yaml`` at the top (relative to the file that says it) is read first; mappings are
    merged key by key, lists and scalars are replaced, and every value keeps its own place.

    Raises:
        MissingProfileError: if the file itself does not exist.
        RejectedProfileError: if it or a file it extends is not a strict YAML mapping.
    """
    mark = Mark(str(path), 1, 1)
    if not path.exists():
        raise MissingProfileError([Problem(mark, (), "no such file")])
    return _extended(parse_tree(_read_bytes(path, mark, ()), str(path)), path, (path.resolve(),))


def _read_bytes(path: Path, mark: Mark, key: KeyPath) -> bytes:
    if not path.is_file():
        raise refuse(mark, key, f"{quoted(str(path), 120)} is not a file")
    try:
        with path.open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except OSError as error:
        raise refuse(mark, key, f"cannot be read: {error.strerror}") from None


def _extended(tree: Node, path: Path, chain: tuple[Path, ...]) -> Node:
    """Merge what `tree` says over the file that it extends."""
    assert isinstance(tree.value, dict)
    entry = tree.value.get(EXTENDS)
    if entry is None:
        return tree
    own = Node(tree.mark, {key: value for key, value in tree.value.items() if key != EXTENDS}, tree.size)
    mark, target = entry.node.mark, entry.node.value
    if not isinstance(target, str) or not target or Path(target).is_absolute():
        allowed = "the path of a profile relative to this file"
        raise refuse(mark, (EXTENDS,), f"found {described(entry.node)}, allowed is {allowed}")
    base_path = path.parent / target
    if not base_path.exists():
        raise refuse(mark, (EXTENDS,), f"no such file {quoted(str(base_path), 120)}")
    resolved = base_path.resolve()
    if resolved in chain:
        raise refuse(mark, (EXTENDS,), f"{quoted(target)} extends this file in turn: a circle")
    if len(chain) > MAX_EXTENDS:
        raise refuse(
            mark, (EXTENDS,), f"found more than {MAX_EXTENDS} files in a chain, allowed {MAX_EXTENDS}"
        )
    base = parse_tree(_read_bytes(base_path, mark, (EXTENDS,)), str(base_path))
    return merged(_extended(base, base_path, (*chain, resolved)), own)


def merged(base: Node, over: Node) -> Node:
    """Return `base` with what `over` says: mappings key by key, lists and scalars as a whole."""
    if not isinstance(base.value, dict) or not isinstance(over.value, dict):
        return over
    entries = dict(base.value)
    for key, entry in over.value.items():
        known = entries.get(key)
        node = entry.node if known is None else merged(known.node, entry.node)
        entries[key] = Entry(entry.key_mark, node)
    return Node(over.mark, entries, base.size + over.size)
