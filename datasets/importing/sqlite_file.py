"""rosbag2 files in SQLite, whole or damaged."""

from __future__ import annotations

import sqlite3
from array import array
from pathlib import Path

import numpy as np

from codediffuser.datasets.importing.recording import Recording, Topic
from codediffuser.errors import DatasetError


class SqliteRecording(Recording):
    """One `.db3` file. Message definitions are in it from schema version 4 on.

    Raises:
        DatasetError: It is no rosbag2 database.
    """

    format = "rosbag2 sqlite3"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        # A database whose writer was killed has a journal; read-only access recovers it.
        self._database = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
        try:
            rows = self._database.execute(
                "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
            ).fetchall()
            self._definitions = self._read_definitions()
        except sqlite3.DatabaseError as error:
            self._database.close()
            raise DatasetError(f"{path}: is no rosbag2 database ({error})") from None
        self._topic_by_id: dict[int, str] = {}
        for topic_id, name, type_name, encoding in rows:
            if encoding == "cdr":
                schema_encoding, schema = self._definitions.get(type_name, ("", b""))
                self._topic_by_id[topic_id] = name
                self.topics[name] = Topic(name, type_name, "cdr", schema_encoding, schema)
        self._rows: dict[str, array[int]] = {name: array("q") for name in self.topics}
        self._index()

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def read(self, topic: str, index: int) -> bytes:
        """Content of one message; see `Recording.read`."""
        row = self._rows[topic][index]
        try:
            found = self._database.execute(
                "SELECT data FROM messages WHERE id = ?", (row,)
            ).fetchone()
        except sqlite3.DatabaseError as error:
            raise DatasetError(f"{self.path.name}: message {row} is damaged ({error})") from None
        if found is None:
            raise DatasetError(f"{self.path.name}: message {row} is gone")
        return bytes(found[0])

    def _read_definitions(self) -> dict[str, tuple[str, bytes]]:
        """Encoding and definition by type; empty for files of older recorders."""
        tables = self._database.execute("SELECT name FROM sqlite_master").fetchall()
        if ("message_definitions",) not in tables:
            return {}
        rows = self._database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        )
        return {name: (encoding, text.encode()) for name, encoding, text in rows}

    def _index(self) -> None:
        times: dict[str, array[int]] = {name: array("q") for name in self.topics}
        # Row numbers grow as messages arrive. Content pages are not touched.
        cursor = self._database.execute("SELECT id, topic_id, timestamp FROM messages ORDER BY id")
        while True:
            try:
                row = cursor.fetchone()
            except sqlite3.DatabaseError as error:
                self.damage.append(f"{self.path.name} is damaged ({error}); the rest is left out")
                break
            if row is None:
                break
            name = self._topic_by_id.get(row[1])
            if name is not None:
                self._rows[name].append(row[0])
                times[name].append(row[2])
        self.times_ns = {name: np.array(t, np.int64) for name, t in times.items()}
