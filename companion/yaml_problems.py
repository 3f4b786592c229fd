"""From a model's refusal to sentences for the operator: where, what was found, what is allowed.

What is allowed is read from the model's own JSON schema, so a message can never disagree with the bounds.
"""

import difflib
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

from companion.yaml_tree import KeyPath, Mark, Node, Problem, described, quoted

Schema = Mapping[str, Any]
_Item = TypeVar("_Item")

_MISFIT = "misfit"
_TRUTH_WORDS = frozenset({"on", "off", "yes", "no", "y", "n"})
_MAX_LISTED = 12


def misfit(at: KeyPath, found: str, allowed: str) -> PydanticCustomError:
    """Build the error that a validator raises when values contradict each other.

    Args:
        at: path of the value to blame, from the model that validates.
        found: what the profile says.
        allowed: what would have been right.
    """
    return PydanticCustomError(
        _MISFIT, "found {found}, allowed {allowed}", {"at": at, "found": found, "allowed": allowed}
    )


def problems_of(error: ValidationError, tree: Node, model: type[BaseModel]) -> list[Problem]:
    """Turn a validation error into problems, the most relevant first.

    Unknown keys come first, because a misspelt key also leaves the right one missing; missing keys last.
    """
    schema = model.model_json_schema()
    ranked: list[tuple[int, int, Problem]] = []
    seen: set[tuple[Mark, KeyPath]] = set()
    for order, detail in enumerate(error.errors(include_url=False)):
        kind = str(detail["type"])
        loc: KeyPath = tuple(detail["loc"])
        if kind == _MISFIT:
            loc = (*loc, *detail["ctx"]["at"])
        problem = _problem(kind, loc, str(detail["msg"]), tree, schema)
        if (problem.mark, problem.path) not in seen:
            seen.add((problem.mark, problem.path))
            rank = {"extra_forbidden": 0, "missing": 2}.get(kind, 1)
            ranked.append((rank, order, problem))
    return [problem for _, _, problem in sorted(ranked, key=_first_two)]


def _first_two(item: tuple[int, int, _Item]) -> tuple[int, int]:
    return item[:2]


def _problem(kind: str, loc: KeyPath, message: str, tree: Node, schema: Schema) -> Problem:
    mark, key_mark, node, path, rest = _locate(tree, loc)
    inner = _descend(schema, schema, path)
    if kind == "extra_forbidden":
        names = _keys(_descend(schema, schema, path[:-1]), schema)
        return Problem(key_mark, path, _unknown_key(path[-1], names))
    if kind == "missing" and rest and isinstance(rest[0], str):
        wanted = describe(_descend(schema, schema, (*path, rest[0])), schema)
        return Problem(mark, (*path, rest[0]), f"missing, allowed is {wanted}")
    if kind == _MISFIT:
        return Problem(mark, (*path, *rest), message)
    if kind in ("value_error", "assertion_error"):
        return Problem(mark, path, message.partition(", ")[2] or message)
    found = f"found {described(node)}, allowed is {describe(inner, schema)}"
    return Problem(mark, path, found + _hint(node, inner, schema))


def _locate(tree: Node, loc: KeyPath) -> tuple[Mark, Mark, Node, KeyPath, KeyPath]:
    """Follow a path as far as the tree goes.

    Parts that the tree does not know in the middle (a union's branch names) are stepped over.

    Returns:
        The place to show, the place of the key, the node there, the path walked, and the unknown parts
        after it. A mapping is shown at its key, because its first line is already its content.
    """
    node, path = tree, []
    mark, key_mark = tree.mark, tree.mark
    unknown: list[str | int] = []
    for part in loc:
        value = node.value
        if isinstance(value, dict) and part in value:
            entry = value[str(part)]
            node, mark, key_mark = entry.node, entry.node.mark, entry.key_mark
        elif isinstance(value, list) and isinstance(part, int) and part < len(value):
            node = value[part]
            mark = key_mark = node.mark
        else:
            unknown.append(part)
            continue
        path.append(part)
        unknown.clear()
    of_mapping = isinstance(node.value, dict) and bool(path)
    return (key_mark if of_mapping else mark), key_mark, node, tuple(path), tuple(unknown)


def _resolved(schema: Schema, root: Schema) -> Schema:
    while "$ref" in schema:
        schema = root["$defs"][str(schema["$ref"]).rpartition("/")[2]]
    return schema


def _branches(schema: Schema, root: Schema) -> list[Schema]:
    """Return the alternatives of a schema, itself when there are none."""
    schema = _resolved(schema, root)
    options = schema.get("anyOf") or schema.get("oneOf")
    if not options:
        return [schema]
    return [branch for option in options for branch in _branches(option, root)]


def _descend(schema: Schema, root: Schema, path: KeyPath) -> Schema:
    """Return the schema at a path; empty (anything) where the schema does not say."""
    if not path:
        return _resolved(schema, root)
    part, rest = path[0], path[1:]
    for branch in _branches(schema, root):
        inner: Schema | None = None
        if isinstance(part, int):
            prefix = branch.get("prefixItems", ())
            inner = prefix[part] if part < len(prefix) else branch.get("items")
        elif part in branch.get("properties", {}):
            inner = branch["properties"][part]
        elif isinstance(branch.get("additionalProperties"), Mapping):
            inner = branch["additionalProperties"]
        if isinstance(inner, Mapping):
            return _descend(inner, root, rest)
    return {}


def _keys(schema: Schema, root: Schema) -> list[str]:
    return [key for branch in _branches(schema, root) for key in branch.get("properties", {})]


def _unknown_key(key: str | int, names: list[str]) -> str:
    close = difflib.get_close_matches(str(key), names, n=1, cutoff=0.6)
    if close:
        return f"unknown key, did you mean {close[0]}?"
    return (
        f"unknown key, allowed are {_listed(sorted(names))}" if names else "unknown key, none is allowed here"
    )


def _hint(node: Node, schema: Schema, root: Schema) -> str:
    """Return advice for the usual slips, starting with a space or a comma; empty when there is none."""
    if not isinstance(node.value, str):
        kinds = {branch.get("type") for branch in _branches(schema, root)}
        number = isinstance(node.value, int | float) and not isinstance(node.value, bool)
        return " (put it in quotes)" if number and "string" in kinds else ""
    branches = _branches(schema, root)
    kinds = {branch.get("type") for branch in branches}
    if "boolean" in kinds and node.value.lower() in _TRUTH_WORDS:
        return f" (write {'true' if node.value.lower() in ('on', 'yes', 'y') else 'false'})"
    if kinds & {"number", "integer"} and _reads_as_number(node.value):
        return " (write it without quotes)"
    words = [str(word) for branch in branches for word in branch.get("enum", ())]
    close = difflib.get_close_matches(node.value, words, n=1, cutoff=0.6)
    return f", did you mean {close[0]}?" if close else ""


def _reads_as_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def describe(schema: Schema, root: Schema) -> str:
    """Say in words which values a JSON schema admits."""
    branches = _branches(schema, root)
    if len(branches) > 1:
        return " or ".join(dict.fromkeys(describe(branch, root) for branch in branches))
    only = branches[0]
    if "const" in only:
        return quoted(only["const"]) if isinstance(only["const"], str) else str(only["const"])
    if "enum" in only:
        words = [quoted(word) if isinstance(word, str) else str(word) for word in only["enum"]]
        return words[0] if len(words) == 1 else f"one of {_listed(words)}"
    kind = only.get("type")
    if kind == "boolean":
        return "true or false"
    if kind in ("integer", "number"):
        return ("an integer" if kind == "integer" else "a number") + _range(only)
    if kind == "string":
        return "text" + _text_limits(only)
    if kind == "array":
        return _describe_list(only, root)
    if kind == "object":
        keys = only.get("properties")
        return f"a mapping with the keys {_listed(list(keys))}" if keys else "a mapping"
    return "nothing (null)" if kind == "null" else "another value"


def _range(schema: Schema) -> str:
    low, above = schema.get("minimum"), schema.get("exclusiveMinimum")
    high, below = schema.get("maximum"), schema.get("exclusiveMaximum")
    if low is not None and high is not None:
        return f" from {low:g} to {high:g}"
    parts = [
        f"{word} {bound:g}"
        for word, bound in (("at least", low), ("above", above), ("at most", high), ("below", below))
        if bound is not None
    ]
    return f" {' and '.join(parts)}" if parts else ""


def _text_limits(schema: Schema) -> str:
    low, high, pattern = schema.get("minLength"), schema.get("maxLength"), schema.get("pattern")
    parts = []
    if low is not None or high is not None:
        parts.append(
            f" of {low or 0} to {high} characters" if high is not None else f" of {low} or more characters"
        )
    if pattern is not None:
        parts.append(f" matching {pattern}")
    return "".join(parts)


def _describe_list(schema: Schema, root: Schema) -> str:
    low, high = schema.get("minItems"), schema.get("maxItems")
    count = ""
    if low is not None and high is not None:
        count = f" of {low} items" if low == high else f" of {low} to {high} items"
    elif low is not None or high is not None:
        count = f" of at least {low} items" if low is not None else f" of at most {high} items"
    items: Iterable[Schema] = schema.get("prefixItems") or [schema.get("items") or {}]
    words = list(dict.fromkeys(describe(item, root) for item in items))
    return f"a list{count}" + (
        f", each {words[0]}" if len(words) == 1 and words[0] != "another value" else ""
    )


def _listed(words: list[str]) -> str:
    shown = words[:_MAX_LISTED]
    more = f" and {len(words) - len(shown)} more" if len(words) > len(shown) else ""
    return ", ".join(shown) + more
