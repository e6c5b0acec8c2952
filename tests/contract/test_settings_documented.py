import re
from pathlib import Path

from jobs.settings import Settings

PAGE = (Path(__file__).parents[2] / "docs" / "settings.md").read_text()


def test_every_setting_is_documented_and_nothing_else() -> None:
    assert re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE) == list(Settings.model_fields)


def test_documented_numbers_are_the_defaults() -> None:
    documented = dict(re.findall(r"^\| `(\w+)` \| ([0-9.]+) \|", PAGE, re.MULTILINE))
    assert len(documented) > 20
    for name, value in documented.items():
        assert float(value) == Settings.model_fields[name].get_default(), name
