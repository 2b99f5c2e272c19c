"""The page of measured figures, docs/results.md: tables between markers, made by the scripts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from mjmotion.exceptions import OutputError

PAGE = Path(__file__).parents[1] / "docs" / "results.md"


def write(mark: str, table: str, machine: Mapping[str, str], packages: Iterable[str]) -> None:
    """Replace what stands between ``<!-- mark -->`` and ``<!-- /mark -->`` on the page.

    Args:
      mark: which of the page's tables.
      table: it as Markdown.
      machine: what it was measured on.
      packages: of those in ``machine``, the packages that matter.

    Raises:
      OutputError: the page cannot be read, or has no such markers.
    """
    try:
        text = PAGE.read_text("utf-8")
    except OSError as error:
        raise OutputError(f"'{PAGE.name}' cannot be read: {error.strerror}") from error
    versions = ", ".join(f"{name} {machine[name]}" for name in packages)
    where = f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}"
    PAGE.write_text(
        put_between(text, mark, f"{table}\n\nMeasured on: {where}, {versions}."), "utf-8"
    )


def put_between(text: str, mark: str, content: str) -> str:
    """Return a text with what stands between two markers replaced.

    Raises:
      OutputError: the text has no such markers.
    """
    begin, end = f"<!-- {mark} -->", f"<!-- /{mark} -->"
    before, opened, rest = text.partition(begin)
    _, closed, after = rest.partition(end)
    if not (opened and closed):
        raise OutputError(f"there is no place for the table: write {begin}{end} into the page")
    return f"{before}{begin}\n{content}\n{end}{after}"
