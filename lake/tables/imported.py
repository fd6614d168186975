"""How rows of a lake say that they were imported: a campaign's config, and the versions of its simulations."""

import json
import tomllib
from typing import Final

IMPORTED: Final = "imported"  # `kind` of such a campaign's config, and tier of such a version


def is_imported(config_toml: str) -> bool:
    """Return whether this is the config of a campaign that was imported, which nothing can run."""
    return tomllib.loads(config_toml).get("kind") == IMPORTED


def importing_campaign(version_json: str) -> str | None:
    """Return the campaign with which simulations of this version were imported, None if they were computed here."""
    imported = json.loads(version_json).get("imported")
    return None if imported is None else str(imported)
