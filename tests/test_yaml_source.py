"""Strict YAML loading: every trap, every bound, every message."""

import re
from enum import Enum
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field, model_validator

from companion.errors import ProfileError
from companion.settings import Settings
from companion.yaml_problems import misfit
from companion.yaml_source import MAX_EXTENDS, load, loads
from companion.yaml_tree import MAX_BYTES, MissingProfileError, RejectedProfileError

LINE = re.compile(r"[^:\n]+:\d+:\d+: \S[^\n]*")


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


class Inner(Settings):
    v_max_mps: float = Field(default=1.0, gt=0.0, le=5.0)
    """Largest speed."""

    count: int = Field(default=3, ge=1, le=9)
    """How many."""

    enabled: bool = False
    """Whether."""

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where."""

    low: float = 0.0
    """Lower limit."""

    high: float = 1.0
    """Upper limit."""

    @model_validator(mode="after")
    def _ordered(self) -> "Inner":
        if self.low > self.high:
            raise misfit(("low",), f"{self.low}", f"at most high, {self.high}")
        if self.high > 100.0:
            raise ValueError("high is absurd")
        return self


class Outer(Settings):
    name: str = Field(min_length=1, max_length=12)
    """Name."""

    inner: Inner = Inner()
    """Nested."""

    maybe: Inner | None = None
    """Optional."""

    kind: Literal["leader", "follower"] = "leader"
    """Literal."""

    colour: Colour = Colour.RED
    """Enum."""

    points: tuple[tuple[float, float], ...] = ()
    """List of pairs."""

    gains: dict[str, float] = Field(default_factory=dict)
    """Free keys."""

    either: int | Literal["auto"] = "auto"
    """Union."""


def refusal(text: str | bytes) -> str:
    with pytest.raises(RejectedProfileError) as caught:
        loads(text, Outer, name="p.yaml")
    message = str(caught.value)
    assert LINE.fullmatch(message), message
    assert message == str(caught.value.problems[0])
    return message


def test_a_complete_profile_becomes_a_frozen_model() -> None:
    text = "name: a\ninner: {v_max_mps: 3, enabled: true, position_m: [1, 2.5, -3e0]}\n"
    text += "colour: blue\npoints: [[1, 2]]"
    profile = loads(text, Outer)
    assert profile.inner.v_max_mps == 3.0
    assert isinstance(profile.inner.v_max_mps, float)
    assert profile.inner.position_m == (1.0, 2.5, -3.0)
    assert profile.colour is Colour.BLUE
    assert profile.points == ((1.0, 2.0),)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: a\nnme: b\n", "p.yaml:2:1: nme: unknown key, did you mean name?"),
        (
            "name: a\ninner:\n  v_max: 2\n",
            "p.yaml:3:3: inner.v_max: unknown key, did you mean v_max_mps?",
        ),
        (
            "name: a\ninner:\n  zzz: 2\n",
            "p.yaml:3:3: inner.zzz: unknown key, "
            "allowed are count, enabled, high, low, position_m, v_max_mps",
        ),
        ("inner: {}\n", "p.yaml:1:1: name: missing, allowed is text of 1 to 12 characters"),
        (
            "name: a\ninner:\n  v_max_mps: 7\n",
            "p.yaml:3:14: inner.v_max_mps: found 7, allowed is a number above 0 and at most 5",
        ),
        (
            "name: a\ninner:\n  v_max_mps: fast\n",
            "p.yaml:3:14: inner.v_max_mps: found text 'fast', allowed is a number above 0 and at most 5",
        ),
        (
            "name: a\ninner: {v_max_mps: '3'}\n",
            "p.yaml:2:20: inner.v_max_mps: found text '3', allowed is a number above 0 and at most 5"
            " (write it without quotes)",
        ),
        (
            "name: a\ninner: {count: 3.0}\n",
            "p.yaml:2:16: inner.count: found 3.0, allowed is an integer from 1 to 9",
        ),
        (
            "name: a\ninner: {enabled: on}\n",
            "p.yaml:2:18: inner.enabled: found text 'on', allowed is true or false (write true)",
        ),
        (
            "name: a\ninner: {enabled: 1}\n",
            "p.yaml:2:18: inner.enabled: found 1, allowed is true or false",
        ),
        (
            "name: a\ninner: {position_m: [1, 2]}\n",
            "p.yaml:2:21: inner.position_m: found a list of 2 items, "
            "allowed is a list of 3 items, each a number",
        ),
        (
            "name: a\ninner: {position_m: [1, 2, 3, 4]}\n",
            "p.yaml:2:21: inner.position_m: found a list of 4 items, "
            "allowed is a list of 3 items, each a number",
        ),
        (
            "name: a\npoints: [[1, 2], [3, x]]\n",
            "p.yaml:2:22: points[1][1]: found text 'x', allowed is a number",
        ),
        ("name: a\ninner: 3\n", "p.yaml:2:8: inner: found 3, allowed is a mapping with the keys v_max_mps, "),
        ("name: a\ninner:\n", "p.yaml:2:7: inner: found nothing (null), allowed is a mapping with the keys "),
        (
            "name: a\nkind: leadr\n",
            "p.yaml:2:7: kind: found text 'leadr', "
            "allowed is one of 'leader', 'follower', did you mean leader?",
        ),
        (
            "name: a\ncolour: green\n",
            "p.yaml:2:9: colour: found text 'green', allowed is one of 'red', 'blue'",
        ),
        (
            "name: 12\n",
            "p.yaml:1:7: name: found 12, allowed is text of 1 to 12 characters (put it in quotes)",
        ),
        ("name: true\n", "p.yaml:1:7: name: found true, allowed is text of 1 to 12 characters"),
        ("name: ''\n", "p.yaml:1:7: name: found text '', allowed is text of 1 to 12 characters"),
        ("name: a\ngains: {k: [1]}\n", "p.yaml:2:12: gains.k: found a list of 1 item, allowed is a number"),
        ("name: a\neither: x\n", "p.yaml:2:9: either: found text 'x', allowed is an integer or 'auto'"),
        (
            "name: a\nmaybe: {count: 0}\n",
            "p.yaml:2:16: maybe.count: found 0, allowed is an integer from 1 to 9",
        ),
        ("name: a\ninner: {low: 2}\n", "p.yaml:2:14: inner.low: found 2.0, allowed at most high, 1.0"),
        ("name: a\ninner:\n  high: 1e3\n", "p.yaml:2:1: inner: high is absurd"),
    ],
)
def test_a_value_that_does_not_fit_is_named_with_place_found_and_allowed(text: str, message: str) -> None:
    found = refusal(text)
    assert found.startswith(message) if message.endswith(" ") else found == message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "name: a\nname: b\n",
            "p.yaml:2:1: name: found the key a second time (first on line 1), allowed once",
        ),
        ("name: 010\n", "p.yaml:1:7: name: found '010', allowed are numbers without a leading zero"),
        ("name: 0x1F\n", "p.yaml:1:7: name: found '0x1F', allowed are decimal numbers"),
        ("name: 1_000\n", "p.yaml:1:7: name: found '1_000', allowed are decimal numbers"),
        ("inner: {low: .nan}\n", "p.yaml:1:14: inner.low: found .nan, allowed are finite numbers"),
        ("inner: {low: -.inf}\n", "p.yaml:1:14: inner.low: found -.inf, allowed are finite numbers"),
        ("inner: {low: 1e999}\n", "p.yaml:1:14: inner.low: found 1e999, allowed are finite numbers"),
        ("inner: {low: " + "9" * 5000 + "}\n", "p.yaml:1:14: inner.low: found a number of 5000 characters"),
        ("name: !!python/object:os.system x\n", "p.yaml:1:7: name: found the tag "),
        ("name: a\ninner: &a {low: 1}\nmaybe: {<<: *a}\n", "p.yaml:3:9: maybe: found the merge key '<<'"),
        ("name: *gone\n", "p.yaml:1:7: name: the alias *gone has no anchor"),
        ("name: &a [*a]\n", "p.yaml:1:11: name[0]: the alias *a contains itself"),
        ("? [a]\n: b\n", "p.yaml:1:3: found a key that is not a plain word"),
        ("'': b\n", "p.yaml:1:1: found a key that is not a plain word"),
        ("", "p.yaml:1:1: found an empty file, allowed is a mapping"),
        ("# only a comment\n", "p.yaml:1:1: found an empty file, allowed is a mapping"),
        ("- a\n- b\n", "p.yaml:1:1: found a list of 2 items, allowed is a mapping"),
        ("text\n", "p.yaml:1:1: found text 'text', allowed is a mapping"),
        ("name: a\n\tinner: b\n", "p.yaml:2:1: found a tab, allowed is indentation by spaces"),
        ("name: a\n---\nname: b\n", "p.yaml:2:1: found a second document, allowed is one"),
        ("name: [a\n", "p.yaml:2:1: not valid YAML: while parsing a flow sequence, "),
        ("name: 'a\n", "p.yaml:2:1: not valid YAML: "),
        ("name: a\n b: c\n", "p.yaml:2:3: not valid YAML: "),
        ("name: @a\n", "p.yaml:1:7: not valid YAML: "),
        (b"name: a\nkind: \xff\n", "p.yaml:2:7: found byte 0xff, allowed is UTF-8 text"),
        (b"\xff\xfen\x00", "p.yaml:1:1: found byte 0xff, allowed is UTF-8 text"),
        ("name: a\x00b\n", "p.yaml:1:8: found a NUL, allowed is printable text"),
        (
            "name: a\nkind: \x07\n",
            "p.yaml:2:7: found the control character '\\x07', allowed is printable text",
        ),
        ('name: "\\ud800"\n', "p.yaml:1:7: name: found a NUL or half a character, allowed is text"),
        ("extends: other.yaml\n", "p.yaml:1:1: extends: allowed in files only"),
        ("name: " + "[" * 5000, "p.yaml:1:31: found more than 24 levels of nesting, allowed 24"),
        ("# " + "x" * MAX_BYTES, f"p.yaml:1:1: found more than {MAX_BYTES} bytes"),
    ],
)
def test_a_trap_of_the_format_is_refused_in_one_line(text: str | bytes, message: str) -> None:
    assert refusal(text).startswith(message)


def test_an_alias_bomb_is_refused_before_it_is_expanded() -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 12)]
    assert "values with aliases written out" in refusal("\n".join(lines))


def test_an_alias_repeats_a_value() -> None:
    profile = loads("name: a\ninner: &limits {low: -1}\nmaybe: *limits\n", Outer)
    assert profile.maybe == profile.inner


@pytest.mark.parametrize("word", ["on", "off", "yes", "no", "12:30", "2026-11-22", "1.2.3", "nan", "="])
def test_words_of_yaml_1_1_are_plain_text(word: str) -> None:
    assert loads(f"name: {word}\n", Outer).name == word


@pytest.mark.parametrize(
    ("text", "value"),
    [("1e3", 1000.0), ("1E-3", 0.001), ("-.5", -0.5), ("+2", 2.0), ("3.", 3.0), ("0", 0.0), ("0.5e+1", 5.0)],
)
def test_numbers_are_read_as_yaml_1_2_reads_them(text: str, value: float) -> None:
    assert loads(f"name: a\ngains: {{k: {text}}}\n", Outer).gains == {"k": value}


def test_an_integer_too_large_to_be_exact_is_still_a_number() -> None:
    assert loads("name: a\ngains: {k: 123456789012345678901234567890}\n", Outer).gains["k"] == pytest.approx(
        1.2345678901e29
    )


def test_a_byte_order_mark_is_skipped() -> None:
    assert loads(b"\xef\xbb\xbfname: a\n", Outer).name == "a"


def test_a_misspelt_required_key_is_reported_before_the_missing_one_and_both_are_kept() -> None:
    with pytest.raises(RejectedProfileError) as caught:
        loads("nmae: a\ninner: {count: 0}\n", Outer, name="p.yaml")
    assert [problem.path for problem in caught.value.problems] == [("nmae",), ("inner", "count"), ("name",)]


def test_long_or_many_lined_text_stays_one_short_line() -> None:
    message = refusal('name: "' + "x\\ny" * 500 + '"\n')
    assert len(message) < 150


class TestExtends:
    def write(self, folder: Path, **files: str) -> Path:
        for name, text in files.items():
            (folder / f"{name}.yaml").write_text(text)
        return folder / "a.yaml"

    def test_mappings_merge_and_lists_are_replaced(self, tmp_path: Path) -> None:
        path = self.write(
            tmp_path,
            base="name: base\ninner: {low: -1, high: 5}\npoints: [[1, 2], [3, 4]]\nmaybe: {low: 0}\n",
            a="extends: base.yaml\ninner: {high: 6}\npoints: [[9, 9]]\nmaybe: null\n",
        )
        profile = load(path, Outer)
        assert (profile.name, profile.inner.low, profile.inner.high) == ("base", -1.0, 6.0)
        assert profile.points == ((9.0, 9.0),)
        assert profile.maybe is None

    def test_a_wrong_value_is_reported_where_it_stands(self, tmp_path: Path) -> None:
        (tmp_path / "sub").mkdir()
        (tmp_path / "sub" / "b.yaml").write_text("extends: ../c.yaml\nname: x\n")
        path = self.write(tmp_path, a="extends: sub/b.yaml\n", c="inner:\n  count: 77\n")
        with pytest.raises(RejectedProfileError) as caught:
            load(path, Outer)
        problem = caught.value.problems[0]
        assert Path(problem.mark.file).resolve() == (tmp_path / "c.yaml").resolve()
        assert (problem.mark.line, problem.mark.column) == (2, 10)

    @pytest.mark.parametrize(
        ("files", "message"),
        [
            (
                {"a": "extends: a.yaml\n"},
                "a.yaml:1:10: extends: 'a.yaml' extends this file in turn: a circle",
            ),
            (
                {"a": "extends: b.yaml\n", "b": "extends: ./a.yaml\n"},
                "b.yaml:1:10: extends: './a.yaml' extends ",
            ),
            ({"a": "name: x\nextends: gone.yaml\n"}, "a.yaml:2:10: extends: no such file "),
            (
                {"a": "extends: [b.yaml]\n"},
                "a.yaml:1:10: extends: found a list of 1 item, allowed is the path",
            ),
            (
                {"a": "extends: /etc/b.yaml\n"},
                "a.yaml:1:10: extends: found text '/etc/b.yaml', allowed is the ",
            ),
            ({"a": "extends: .\n"}, "a.yaml:1:10: extends: "),
            ({"a": "extends: b.yaml\n", "b": "x: [\n"}, "b.yaml:2:1: not valid YAML"),
        ],
    )
    def test_a_broken_chain_is_refused(self, tmp_path: Path, files: dict[str, str], message: str) -> None:
        path = self.write(tmp_path, **files)
        with pytest.raises(RejectedProfileError) as caught:
            load(path, Outer)
        text = str(caught.value)
        assert LINE.fullmatch(text)
        assert text.removeprefix(f"{tmp_path}/").startswith(message)

    def test_a_chain_that_is_too_long_is_refused(self, tmp_path: Path) -> None:
        links = {f"a{n}": f"extends: a{n + 1}.yaml\n" for n in range(MAX_EXTENDS + 1)}
        self.write(tmp_path, **links, **{f"a{MAX_EXTENDS + 1}": "name: x\n"})
        assert load(tmp_path / "a1.yaml", Outer).name == "x"
        with pytest.raises(RejectedProfileError, match="files in a chain"):
            load(tmp_path / "a0.yaml", Outer)


def test_a_missing_file_and_a_folder_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(MissingProfileError, match=r":1:1: no such file"):
        load(tmp_path / "gone.yaml", Outer)
    with pytest.raises(RejectedProfileError, match="is not a file"):
        load(tmp_path, Outer)


FRAGMENTS = st.sampled_from(
    [
        "name",
        ": ",
        "\n",
        "  ",
        "- ",
        "[",
        "]",
        "{",
        "}",
        "&a ",
        "*a",
        "'",
        '"',
        "|",
        ">",
        "?",
        "#",
        "!!t ",
        "%",
        "---",
    ]
)


@settings(max_examples=150)
@given(
    st.one_of(
        st.binary(max_size=60), st.lists(FRAGMENTS, max_size=25).map(lambda parts: "".join(parts).encode())
    )
)
def test_no_input_escapes_as_anything_but_one_line(data: bytes) -> None:
    message = "p.yaml:1:1: fine"
    try:
        loads(data, Outer, name="p.yaml")
    except ProfileError as error:
        message = str(error)
    assert LINE.fullmatch(message)
