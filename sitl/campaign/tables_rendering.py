"""A table of texts, and how it looks in Markdown, LaTeX and HTML."""

import html
from dataclasses import dataclass, field
from itertools import groupby

_LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "–": "--",
    "—": "---",
}


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table.

    Attributes:
        cells: as many as the table has columns.
        published: it is the paper's, not ours.
    """

    cells: tuple[str, ...]
    published: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """What is printed.

    Attributes:
        name: identifier, used as the LaTeX label.
        title: caption.
        names: headings of the columns that say what a row is about; a line separates rows whenever the first
            of them changes.
        values: headings of the other columns.
        notes: what must be known to read it.
    """

    name: str
    title: str
    names: tuple[str, ...]
    values: tuple[str, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        """Check that every row is complete.

        Raises:
            ValueError: if one is not.
        """
        width = len(self.names) + len(self.values)
        for row in self.rows:
            if len(row.cells) != width:
                raise ValueError(
                    f"a row of {len(row.cells)} cells in a table of {width} columns: {row.cells}"
                )


def markdown(table: Table) -> str:
    """Return a heading, the table and its notes."""
    head = (*table.names, *table.values)
    lines = [head, tuple("---" for _ in table.names) + tuple("---:" for _ in table.values)]
    lines += [tuple(cell.replace("|", "\\|") for cell in row.cells) for row in table.rows]
    body = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    notes = "".join(f"\n{note}\n" for note in table.notes)
    return f"## {table.title}\n\n{body}\n{notes}"


def latex(table: Table) -> str:
    r"""Return a ``table*`` for documents that load booktabs; the first name is printed once a group."""
    columns = "l" * len(table.names) + "r" * len(table.values)
    head = " & ".join(rf"\textbf{{{_latex(word)}}}" for word in (*table.names, *table.values))
    groups = []
    for _, rows in groupby(table.rows, key=lambda row: row.cells[0]):
        lines = []
        for index, row in enumerate(rows):
            cells = [_latex(cell) for cell in row.cells]
            if row.published:
                cells[1:] = [rf"\textit{{{cell}}}" if cell else "" for cell in cells[1:]]
            if index:
                cells[0] = ""
            lines.append("    " + " & ".join(cells) + r" \\")
        groups.append("\n".join(lines))
    body = "\n    \\midrule\n".join(groups)
    notes = "".join(rf"  \par\footnotesize {_latex(note)}" + "\n" for note in table.notes)
    return (
        "\\begin{table*}[t]\n  \\centering\n"
        f"  \\caption{{{_latex(table.title)}}}\n  \\label{{tab:{table.name}}}\n"
        f"  \\begin{{tabular}}{{@{{}}{columns}@{{}}}}\n    \\toprule\n    {head} \\\\\n    \\midrule\n"
        f"{body}\n    \\bottomrule\n  \\end{{tabular}}\n{notes}\\end{{table*}}\n"
    )


def html_table(table: Table) -> str:
    """Return a section of a page."""
    names = len(table.names)
    head = "".join(
        f'<th class="name">{html.escape(word)}</th>' if index < names else f"<th>{html.escape(word)}</th>"
        for index, word in enumerate((*table.names, *table.values))
    )
    lines = []
    before = None
    for row in table.rows:
        first = row.cells[0] != before
        kinds = [word for word, holds in (("first", first), ("paper", row.published)) if holds]
        cells = [html.escape(cell) for cell in row.cells]
        if not first:
            cells[0] = ""
        body = "".join(
            f'<td class="name">{cell}</td>' if index < names else f"<td>{cell}</td>"
            for index, cell in enumerate(cells)
        )
        lines.append(f'<tr class="{" ".join(kinds)}">{body}</tr>')
        before = row.cells[0]
    notes = "".join(f'<p class="note">{html.escape(note)}</p>' for note in table.notes)
    return (
        f'<section class="card" id="{html.escape(table.name)}"><h2>{html.escape(table.title)}</h2>'
        f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody></table>{notes}</section>"
    )


def _latex(text: str) -> str:
    return "".join(_LATEX.get(letter, letter) for letter in text)
