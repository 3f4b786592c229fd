"""One line of the go/no-go table."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Literal

from companion.errors import CompanionError

Verdict = Literal["ok", "warn", "fail", "skipped"]


@dataclass(frozen=True, slots=True)
class Check:
    """Outcome of one check.

    Attributes:
        name: what was looked at.
        verdict: "fail" forbids the flight, "warn" does not, "skipped" was not looked at.
        reason: what was found, one sentence.
    """

    name: str
    verdict: Verdict
    reason: str

    def as_dict(self) -> dict[str, str]:
        """Return the fields by name."""
        return {name: str(value) for name, value in asdict(self).items()}


def guarded(name: str, look: Callable[[], Check | Sequence[Check]]) -> list[Check]:
    """Run one look; an error on purpose, or of the system, is the failure of what it is named after."""
    try:
        found = look()
    except (CompanionError, OSError) as error:
        return [Check(name, "fail", " ".join(str(error).split()))]
    return [found] if isinstance(found, Check) else list(found)


def is_go(checks: Iterable[Check]) -> bool:
    """Return whether nothing failed."""
    return all(check.verdict != "fail" for check in checks)
