"""A job taken out of a batch as a folder: out of a shard's file, or a copy of its folder."""

from __future__ import annotations

import zipfile
from pathlib import Path, PurePosixPath

from mjmotion.apps.batch.record import Record
from mjmotion.apps.batch.rows import Row
from mjmotion.apps.batch.storage import JOBS, SHARDS, Storage
from mjmotion.boundary.words import first_line
from mjmotion.exceptions import BatchError, unknown_name
from mjmotion.output.folder import result_folder


def find_row(storage: Storage, record: Record, name: str) -> Row:
    """Return the line of a job of a batch.

    Raises:
      BatchError: there is no such job, or it has no result.
    """
    known = record.known.get(name)
    if known is None:
        if not record.known:
            raise BatchError(f"'{storage.address}' holds no batch: give its folder")
        raise BatchError(unknown_name("job", name, record.known)[:500])
    row = next(row for row in record.rows() if row["job"] == name)
    if known.failed:
        raise BatchError(f"job '{name}' has no result: {row['error']}")
    return row


def extract(storage: Storage, name: str, to: str | Path) -> Path:
    """Write one job of a batch into a folder, whole or not at all.

    Args:
      storage: of the batch.
      name: of the job.
      to: the folder.

    Returns:
      The folder.

    Raises:
      BatchError: there is no such job, it has no result, or that is damaged.
      OutputError: the folder holds something already or cannot be written.
    """
    row = find_row(storage, Record(storage), name)
    with result_folder(to) as folder:
        copy_files(storage, row, folder)
    return Path(to)


def copy_files(storage: Storage, row: Row, folder: Path) -> None:
    """Copy the files of a job into a folder that is there.

    Raises:
      BatchError: they are gone, or their shard is damaged.
    """
    name = row["job"]
    if not row["shard"]:
        if not storage.fetch(f"{JOBS}/{name}", folder):
            raise BatchError(f"folder '{storage.address}/{JOBS}/{name}' is gone: run it again")
        return
    with storage.aside() as aside:
        local = aside / "shard.zip"
        if not storage.fetch(f"{SHARDS}/{row['shard']}.zip", local):
            raise BatchError(f"shard '{row['shard']}' of job '{name}' is gone: run it again")
        try:
            with zipfile.ZipFile(local) as file:
                for member in file.namelist():
                    inside = PurePosixPath(member)
                    if inside.parts[:-1] == (name,):
                        (folder / inside.name).write_bytes(file.read(member))
        except zipfile.BadZipFile as error:
            raise BatchError(
                f"shard '{row['shard']}' is damaged ({first_line(error)}): remove it with its"
                " .jsonl, and run it again"
            ) from error
