"""One table of what the benchmarks said, with the machine and its load."""

from collections.abc import Mapping, Sequence

COLUMNS = "benchmark", "value", "unit", "target", "load", "took_s"


def table(rows: Sequence[Mapping[str, object]]) -> str:
    """Markdown: a line per benchmark; one without a single value, skipped or failed, says so in place of the value."""
    devices = sorted({str(row["device"]) for row in rows if "device" in row})
    lines = [" | ".join(_cell(row, column) for column in COLUMNS) for row in rows]
    heading = [f"Machine: {'; '.join(devices) or 'unknown'}.", "", f"| {' | '.join(COLUMNS)} |", "|---" * 6 + "|"]
    return "\n".join([*heading, *(f"| {line} |" for line in lines)]) + "\n"


def _cell(row: Mapping[str, object], column: str) -> str:
    if column == "value" and "value" not in row:
        reason = next((f"{word}: {row[word]}" for word in ("skipped", "failed") if word in row), "see its JSON line")
        return reason.replace("|", "/").replace("\n", " ")
    return str(row.get(column, ""))
