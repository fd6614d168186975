"""Files of older programs: what changed in the columns of each table since, as functions on their rows.

A file says in its metadata, as `fast.schema_version`, which version of its table it holds; one that says nothing
holds the first. To change a column (rename it, split it, give it another unit), change its row record and append to
`MIGRATIONS[table]` the function that makes the rows of today from those of yesterday. Never edit or remove one that
is there. A new column that may be empty needs none: files without it read as empty.
"""

from collections.abc import Callable, Mapping

import pyarrow as pa

Migration = Callable[[pa.Table], pa.Table]
VERSION_KEY = "fast.schema_version"

# The function at place k takes rows of version k + 1 to version k + 2. No table has changed yet.
MIGRATIONS: Mapping[str, tuple[Migration, ...]] = {}


def table_version(table: str) -> int:
    """Version of the columns that this program writes."""
    return 1 + len(MIGRATIONS.get(table, ()))


def file_version(schema: pa.Schema) -> int:
    """Version that a file says it holds."""
    return version_number((schema.metadata or {}).get(VERSION_KEY.encode(), b"").decode())


def version_number(text: str | None) -> int:
    """Version in the metadata of a file; 1 where there is none."""
    return int(text) if text and text.isdigit() else 1


def migrated(rows: pa.Table, table: str) -> pa.Table:
    """Rows of a file, of its version or a later one, with the columns of today."""
    for migration in MIGRATIONS.get(table, ())[file_version(rows.schema) - 1 :]:
        rows = migration(rows)
    return rows
