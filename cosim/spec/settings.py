"""Changes of a specification that options give: `--set group.max_gap=20` is `{"group": {"max_gap": 20}}`."""

from collections.abc import Iterable, Mapping
from typing import Any

from gri.errors import InputError
from gri.yaml_content import content_of

OPTION = "--set"
TAGS = ("kind", "rule", "source")  # a mapping with one of these keys replaces another mapping as a whole


def settings_of(texts: Iterable[str]) -> dict[str, Any]:
    """The changes that texts such as "group.max_gap=20" ask for, as nested mappings. Values are written as in YAML.

    Raises `InputError` for a text of another form, for a value that is not valid YAML, and for a field given twice.
    """
    found: dict[str, Any] = {}
    for text in texts:
        path, equals, value = text.partition("=")
        names = [name.strip() for name in path.split(".")]
        if not equals or not all(names):
            raise InputError(f"{OPTION}: got {text[:200]!r}, expected FIELD=VALUE, such as group.max_gap=20")
        holder = found
        for name in names[:-1]:
            holder = holder.setdefault(name, {})
            if not isinstance(holder, dict):
                break
        if not isinstance(holder, dict) or names[-1] in holder:
            raise InputError(f"{OPTION}: {path} is given twice, or inside a field that is given as well; give it once")
        holder[names[-1]] = content_of(value, f"{OPTION} {path}")[0]
    return found


def overlay(content: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`content` with `changes` in place: mappings are merged field by field, everything else is replaced."""
    result = dict(content)
    for name, value in changes.items():
        old = result.get(name)
        if isinstance(old, dict) and isinstance(value, dict) and not any(tag in value for tag in TAGS):
            value = overlay(old, value)
        result[name] = value
    return result
