"""With which configuration a recorded flight is replayed, and how it differs from the one that flew."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin

from companion.config import Profile, load_profile, profile_text
from companion.errors import LogError, ProfileError
from companion.settings import Settings
from companion.yaml_source import merged, validated
from companion.yaml_tree import Entry, Mark, Node, parse_tree, refuse

ABSENT = "(absent)"
_MAX_DEPTH = 8


@dataclass(frozen=True, slots=True)
class Changed:
    """One value that is not as it was: its name, what it was in flight, and what it is now."""

    name: str
    recorded: str
    replayed: str


def replay_profile(
    configuration: str, path: Path, assignments: Sequence[str], profile: Path | None
) -> tuple[Profile, list[Changed]]:
    """Return the profile to replay with, and where it differs from the recorded one.

    Args:
        configuration: the recorded configuration, YAML.
        path: of the log, for error texts.
        assignments: changes as ``key.path=value``, the value in YAML.
        profile: a profile instead of the recorded one, None for the recorded one.

    Raises:
        ProfileError: if the profile or an assignment is wrong.
        LogError: if the log holds no configuration and none is named.
    """
    if not configuration and profile is None:
        raise LogError(f"{path}: no configuration in this log; name a profile with --profile")
    recorded = parse_tree(configuration, f"{path} (configuration)") if configuration else None
    if profile is not None:
        base = parse_tree(profile_text(load_profile(profile)), str(profile))
    else:
        assert recorded is not None
        # What this version does not know any more cannot be set: it shows among the differences.
        base = _known_part(recorded, Profile)
    for assignment in assignments:
        base = merged(base, _assigned(assignment))
    replayed = validated(base, Profile)
    before = {} if recorded is None else _flat(recorded.plain())
    return replayed, _changes(before, _flat(replayed.model_dump(mode="json")))


def with_assignments(profile: Path, assignments: Sequence[str]) -> Profile:
    """Return a profile from a file, changed by assignments ``key.path=value``.

    Raises:
        ProfileError: if the profile or an assignment is wrong.
    """
    base = parse_tree(profile_text(load_profile(profile)), str(profile))
    for assignment in assignments:
        base = merged(base, _assigned(assignment))
    return validated(base, Profile)


def changed_tables(recorded: Mapping[str, str], replayed: Mapping[str, str]) -> list[Changed]:
    """Return where two tables of texts differ, by name."""
    return _changes(recorded, replayed)


def _assigned(assignment: str) -> Node:
    """Return the tree that says only what one assignment says; every place in it is the assignment."""
    name = f"--set {assignment}"
    key, equals, text = assignment.partition("=")
    parts = key.split(".")
    mark = Mark(name, 0, 0)
    if not equals or not all(parts) or len(parts) > _MAX_DEPTH:
        raise refuse(mark, (), "found no key.path=value, allowed is e.g. odometry.fine_cell_m=0.2")
    try:
        value = parse_tree(f"value: {text}\n", name).value
    except ProfileError:
        raise refuse(mark, tuple(parts), "found no YAML value, allowed is one") from None
    assert isinstance(value, dict)
    if set(value) != {"value"}:
        raise refuse(mark, tuple(parts), "found several lines, allowed is one value")
    node = _placed(value["value"].node, mark)
    for part in reversed(parts):
        node = Node(mark, {part: Entry(mark, node)}, node.size + 1)
    return node


def _placed(node: Node, mark: Mark) -> Node:
    value = node.value
    if isinstance(value, dict):
        value = {key: Entry(mark, _placed(entry.node, mark)) for key, entry in value.items()}
    elif isinstance(value, list):
        value = [_placed(item, mark) for item in value]
    return replace(node, mark=mark, value=value)


def _known_part(node: Node, model: type[Settings]) -> Node:
    """Return a tree without the keys that a settings model and its sections do not know."""
    if not isinstance(node.value, dict):
        return node
    entries: dict[str, Entry] = {}
    for key, entry in node.value.items():
        field = model.model_fields.get(key)
        if field is None:
            continue
        section = _section_of(field.annotation)
        inner = entry.node if section is None else _known_part(entry.node, section)
        entries[key] = Entry(entry.key_mark, inner)
    return replace(node, value=entries)


def _section_of(annotation: Any) -> type[Settings] | None:
    """Return the settings model that a field holds, None if it holds anything else."""
    candidates = get_args(annotation) if get_origin(annotation) in (UnionType, Union) else (annotation,)
    found = [one for one in candidates if isinstance(one, type) and issubclass(one, Settings)]
    return found[0] if len(found) == 1 else None


def _flat(value: object, name: str = "") -> dict[str, str]:
    if isinstance(value, dict):
        flat: dict[str, str] = {}
        for key, inner in value.items():
            flat |= _flat(inner, f"{name}.{key}" if name else str(key))
        return flat
    return {name: _said(value)}


def _said(value: object) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "none"}[value]
    if isinstance(value, int | float):
        return f"{float(value):.12g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_said(item) for item in value) + "]"
    return str(value)


def _changes(before: Mapping[str, str], after: Mapping[str, str]) -> list[Changed]:
    names = [*before, *(name for name in after if name not in before)]
    pairs = ((name, before.get(name, ABSENT), after.get(name, ABSENT)) for name in names)
    return [Changed(name, old, new) for name, old, new in pairs if old != new]
