"""Strict YAML: text to a tree in which every key and value knows its file, line and column.

YAML 1.1 has traps that end in the air: a repeated key silently wins, ``on`` is a truth value, ``010``
is eight and ``1e3`` is text. Here plain scalars follow YAML 1.2, whatever is ambiguous is refused, and
no input can make the reader use much memory, recurse deeply or build an object.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

import yaml

from companion.errors import ProfileError

MAX_BYTES = 256 * 1024
MAX_DEPTH = 24
MAX_NODES = 20_000

Scalar = str | int | float | bool | None
KeyPath = tuple[str | int, ...]

_NULLS = frozenset({"", "~", "null", "Null", "NULL"})
_TRUTHS = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INTEGER = re.compile(r"[-+]?[0-9]+")
_LEADING_ZERO = re.compile(r"[-+]?0[0-9]")
_BASE_PREFIX = re.compile(r"[-+]?0[xXoObB][0-9a-fA-F_]+")
_UNDERSCORED = re.compile(r"[-+]?[0-9][0-9_]*_[0-9_]*(\.[0-9_]*)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_MAX_NUMBER_LENGTH = 40


@dataclass(frozen=True, slots=True)
class Mark:
    """A place in a file; line and column count from 1, and line 0 means all of it."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing wrong with a profile.

    Attributes:
        mark: where it stands.
        path: the key's path from the top of the document, list indices from 0.
        message: what was found and what is allowed.
    """

    mark: Mark
    path: KeyPath
    message: str

    def __str__(self) -> str:
        where = f"{self.mark}: {path_text(self.path)}: " if self.path else f"{self.mark}: "
        return where + " ".join(self.message.split())


class RejectedProfileError(ProfileError):
    """A profile was refused; the text is its first problem, `problems` holds all of them."""

    def __init__(self, problems: list[Problem]) -> None:
        """Take at least one problem, the most relevant first."""
        super().__init__(str(problems[0]))
        self.problems = tuple(problems)


class MissingProfileError(RejectedProfileError):
    """The file named by the operator does not exist."""


@dataclass(frozen=True, slots=True)
class Node:
    """A value with its place.

    Attributes:
        value: a scalar, a list of nodes, or the entries of a mapping by key.
        size: nodes in this subtree with aliases written out.
    """

    mark: Mark
    value: "Scalar | list[Node] | dict[str, Entry]"
    size: int = 1

    def plain(self) -> object:
        """Return the same data as plain lists, dictionaries and scalars."""
        if isinstance(self.value, dict):
            return {key: entry.node.plain() for key, entry in self.value.items()}
        if isinstance(self.value, list):
            return [item.plain() for item in self.value]
        return self.value


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry of a mapping: the place of its key, and its value."""

    key_mark: Mark
    node: Node


def path_text(path: KeyPath) -> str:
    """Write a key path as ``leader.waypoints_m[3].x``."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{_shown(part)}" for part in path).lstrip(".")


def quoted(text: str, limit: int = 40) -> str:
    """Quote text for a message: one line, printable, at most about `limit` characters."""
    return repr(text if len(text) <= limit else text[: limit - 3] + "...")


def refuse(mark: Mark, path: KeyPath, message: str) -> RejectedProfileError:
    """Build the exception for a single problem."""
    return RejectedProfileError([Problem(mark, path, message)])


def parse_tree(source: bytes | str, name: str) -> Node:
    """Parse one YAML document without following ``extends``.

    Args:
        source: the document; bytes must be UTF-8.
        name: the file's name for marks.

    Raises:
        RejectedProfileError: if it is not a strict YAML mapping.
    """
    data = source.encode("utf-8", "surrogatepass") if isinstance(source, str) else source
    start = Mark(name, 1, 1)
    if len(data) > MAX_BYTES:
        raise refuse(start, (), f"found more than {MAX_BYTES} bytes, allowed at most {MAX_BYTES} bytes")
    try:
        text = data.decode("utf-8").removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        mark = _end_mark(data[: error.start].decode("utf-8"), name)
        raise refuse(mark, (), f"found byte 0x{data[error.start]:02x}, allowed is UTF-8 text") from None
    try:
        node = _Composer(text, name).document()
    except yaml.reader.ReaderError as error:
        mark = _end_mark(text[: error.position], name)
        found = f"found the control character {chr(error.character)!a}" if error.character else "found a NUL"
        raise refuse(mark, (), f"{found}, allowed is printable text") from None
    except yaml.MarkedYAMLError as error:
        raise RejectedProfileError([_syntax_problem(error, name)]) from None
    if not isinstance(node.value, dict):
        raise refuse(node.mark, (), f"found {described(node)}, allowed is a mapping of keys to values")
    return node


def described(node: Node) -> str:
    """Say what a node holds, for messages."""
    value = node.value
    if isinstance(value, dict):
        return "a mapping" if value else "an empty mapping"
    if isinstance(value, list):
        return f"a list of {len(value)} item{'' if len(value) == 1 else 's'}"
    if value is None:
        return "nothing (null)"
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"text {quoted(value)}" if isinstance(value, str) else f"{value}"


def _end_mark(text: str, name: str) -> Mark:
    """Return the place just after `text`, the beginning of a file."""
    return Mark(name, text.count("\n") + 1, len(text) - text.rfind("\n"))


def _shown(key: str) -> str:
    """Return a key for a path: as it is when it is a plain word, quoted otherwise."""
    return key if re.fullmatch(r"[\w\-]{1,60}", key) else quoted(key)


def _syntax_problem(error: yaml.MarkedYAMLError, name: str) -> Problem:
    mark = error.problem_mark or error.context_mark
    place = Mark(name, mark.line + 1, mark.column + 1) if mark is not None else Mark(name, 1, 1)
    problem = error.problem or "the text ends too early"
    if "'\\t'" in problem:
        return Problem(place, (), "found a tab, allowed is indentation by spaces")
    context = f" {error.context}" if error.context else ""
    return Problem(place, (), f"not valid YAML:{context}{',' if context else ''} {problem}")


class _Composer:
    """Builds the tree from parser events, within bounds on depth and size."""

    def __init__(self, text: str, name: str) -> None:
        self._events: Iterator[yaml.Event] = iter(yaml.parse(text, Loader=yaml.SafeLoader))
        self._name = name
        self._anchors: dict[str, Node | None] = {}
        self._nodes = 0

    def document(self) -> Node:
        """Return the only document of the stream."""
        next(self._events)
        first = next(self._events)
        if isinstance(first, yaml.StreamEndEvent):
            raise refuse(
                Mark(self._name, 1, 1), (), "found an empty file, allowed is a mapping of keys to values"
            )
        node = self._node(next(self._events), (), 0)
        next(self._events)
        after = next(self._events)
        if not isinstance(after, yaml.StreamEndEvent):
            raise refuse(self._mark(after), (), "found a second document, allowed is one")
        return node

    def _mark(self, event: yaml.Event) -> Mark:
        start = event.start_mark
        assert start is not None
        return Mark(self._name, start.line + 1, start.column + 1)

    def _count(self, nodes: int, mark: Mark, path: KeyPath) -> None:
        self._nodes += nodes
        if self._nodes > MAX_NODES:
            raise refuse(
                mark, path, f"found more than {MAX_NODES} values with aliases written out, allowed fewer"
            )

    def _node(self, event: yaml.Event, path: KeyPath, depth: int) -> Node:
        mark = self._mark(event)
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event, mark, path)
        self._count(1, mark, path)
        if depth > MAX_DEPTH:
            raise refuse(mark, (), f"found more than {MAX_DEPTH} levels of nesting, allowed {MAX_DEPTH}")
        if event.tag is not None:  # type: ignore[attr-defined]
            tag = quoted(event.tag)  # type: ignore[attr-defined]
            raise refuse(mark, path, f"found the tag {tag}, allowed are plain values without tags")
        anchor: str | None = event.anchor  # type: ignore[attr-defined]
        if anchor is not None:
            self._anchors[anchor] = None
        if isinstance(event, yaml.SequenceStartEvent):
            node = self._sequence(mark, path, depth)
        elif isinstance(event, yaml.MappingStartEvent):
            node = self._mapping(mark, path, depth)
        else:
            assert isinstance(event, yaml.ScalarEvent)
            node = Node(mark, _scalar(event, mark, path))
        if anchor is not None:
            self._anchors[anchor] = node
        return node

    def _alias(self, event: yaml.AliasEvent, mark: Mark, path: KeyPath) -> Node:
        name = str(event.anchor)
        node = self._anchors.get(name)
        if node is None:
            inside = name in self._anchors
            raise refuse(mark, path, f"the alias *{name} {'contains itself' if inside else 'has no anchor'}")
        self._count(node.size, mark, path)
        return node

    def _sequence(self, mark: Mark, path: KeyPath, depth: int) -> Node:
        items: list[Node] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            items.append(self._node(event, (*path, len(items)), depth + 1))
        return Node(mark, items, 1 + sum(item.size for item in items))

    def _mapping(self, mark: Mark, path: KeyPath, depth: int) -> Node:
        entries: dict[str, Entry] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            key_mark = self._mark(event)
            key = event.value if isinstance(event, yaml.ScalarEvent) and event.tag is None else ""
            if not key or _unusable(key):
                raise refuse(
                    key_mark, path, "found a key that is not a plain word, allowed are words as keys"
                )
            if key == "<<":
                raise refuse(key_mark, path, "found the merge key '<<', allowed is extends at the top")
            if key in entries:
                first = entries[key].key_mark.line
                message = f"found the key a second time (first on line {first}), allowed once"
                raise refuse(key_mark, (*path, key), message)
            entries[key] = Entry(key_mark, self._node(next(self._events), (*path, key), depth + 1))
        return Node(mark, entries, 1 + sum(entry.node.size for entry in entries.values()))


def _unusable(text: str) -> bool:
    return any(character == "\0" or "\ud800" <= character <= "\udfff" for character in text)


def _scalar(event: yaml.ScalarEvent, mark: Mark, path: KeyPath) -> Scalar:
    """Give a scalar its type: YAML 1.2 core, with the ambiguous spellings refused."""
    text = event.value
    if _unusable(text):
        raise refuse(mark, path, "found a NUL or half a character, allowed is text")
    if event.style is not None:
        return text
    if text in _NULLS:
        return None
    if text in _TRUTHS:
        return _TRUTHS[text]
    if _NOT_FINITE.fullmatch(text):
        raise refuse(mark, path, f"found {text}, allowed are finite numbers")
    if _BASE_PREFIX.fullmatch(text) or _UNDERSCORED.fullmatch(text):
        advice = "allowed are decimal numbers without underscores (put text in quotes)"
        raise refuse(mark, path, f"found {quoted(text)}, {advice}")
    if not _NUMBER.fullmatch(text):
        return text
    if _LEADING_ZERO.match(text):
        advice = "allowed are numbers without a leading zero (put text in quotes)"
        raise refuse(mark, path, f"found {quoted(text)}, {advice}")
    if len(text) > _MAX_NUMBER_LENGTH:
        raise refuse(mark, path, f"found a number of {len(text)} characters, allowed {_MAX_NUMBER_LENGTH}")
    if _INTEGER.fullmatch(text):
        return int(text)
    number = float(text)
    if not math.isfinite(number):
        raise refuse(mark, path, f"found {text}, allowed are finite numbers")
    return number
