"""The session store in a database of SQL, whichever it is."""

from __future__ import annotations

import asyncio
import json
import math
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from pretouch.calibrated_camera import CameraSummary
from pretouch.errors import Unavailable
from pretouch.session import Session
from pretouch_orchestrator.sessions.record import Record
from pretouch_orchestrator.store import camera_rows, camera_sql, rows, sql
from pretouch_orchestrator.store.changes import Changes
from pretouch_orchestrator.store.database import Database, Transaction
from pretouch_orchestrator.store.protocol import (
    Busy,
    CameraMemory,
    CameraUpdate,
    Event,
    KeyedRequest,
    NewEvent,
    Owned,
    Snapshot,
    Stale,
)

_BALLAST = 64 * 1024
"""Bytes that a check writes after a failure: about a step's. Else it writes a single one, to spare the disk."""
_FRESH = 1.0
"""s for which a check that succeeded is not made again, however many ask."""

T = TypeVar("T")


class SqlStore:
    """A `Store` over a database. Messages are encoded and decoded in threads of its own."""

    def __init__(self, database: Database, changes: Changes) -> None:
        self.changes = changes
        self._database = database
        self._codec = ThreadPoolExecutor(2, "pretouch-store-codec")
        self._in_doubt, self._checked = False, -math.inf

    async def create(
        self,
        owner: str,
        record: Record,
        events: Sequence[NewEvent],
        key: KeyedRequest | None,
        camera: CameraUpdate | None = None,
    ) -> Record:
        request, scene, step = await self._encode(
            lambda: (
                rows.request_column(record),
                rows.scene_column(record),
                rows.StepColumns.between(None, record, events),
            )
        )
        values = {
            "id": record.id,
            "owner": owner,
            "created": record.created,
            "request": request,
            "scene": record.scene.digest,
            "origin": json.dumps(record.origin),
            "size": len(request),
            "camera": record.request.camera_id or "",
        }
        believed = rows.pose_column(record.request.base_T_camera)
        summary = camera_rows.new_summary_column(record.request.camera_id or "")
        entry = None if camera is None else camera_rows.entry_columns(camera)

        def work(tx: Transaction) -> None:
            if tx.execute("SELECT 1 FROM session WHERE id = :id", values):
                return  # stored by a transaction whose answer was lost with the connection
            sql.store_scene(tx, record.scene.digest, scene)
            (row,) = tx.execute(
                "INSERT INTO session (id, owner, created, request, scene, origin, version, touched, ended, last_event, "
                "size, skipped, answered, camera) VALUES (:id, :owner, :created, :request, :scene, :origin, 1, "
                "epoch(), 0, 0, :size, '[]', '[]', :camera) RETURNING number",
                values,
            )
            number = row["number"]
            sql.store_step(tx, number, step)
            if record.request.camera_id is not None:
                camera_sql.store_camera(tx, owner, record.request.camera_id, believed, summary)
            if entry is not None:
                camera_sql.store_entry(tx, number, entry)
            if key is not None and not sql.store_key(tx, owner, key, number):
                raise Stale

        await self._write(work)
        return record.with_version(1)

    async def update(
        self,
        before: Record,
        after: Record,
        events: Sequence[NewEvent],
        lease: str | None,
        camera: CameraUpdate | None = None,
    ) -> Record:
        step = await self._encode(lambda: rows.StepColumns.between(before, after, events))
        entry = None if camera is None else camera_rows.entry_columns(camera)

        def work(tx: Transaction) -> None:
            if lease is None and sql.is_leased(tx, before.id):
                raise Busy
            number = sql.next_version(tx, before.id, before.version)
            sql.store_step(tx, number, step)
            if entry is not None:
                camera_sql.store_entry(tx, number, entry)
            if lease is not None:
                sql.release_lease(tx, before.id, lease)
            tx.announce(before.id)

        await self._write(work)
        return after.with_version(before.version + 1)

    async def end(self, before: Snapshot, after: Session, events: Sequence[NewEvent]) -> None:
        view, data = await self._encode(lambda: (rows.view_column(after), rows.event_columns(events)))

        def work(tx: Transaction) -> None:
            number = sql.next_version(tx, after.id, before.version)
            tx.execute("UPDATE session SET ended = 1 WHERE number = :number", {"number": number})
            tx.execute("DELETE FROM told WHERE session = :number", {"number": number})
            sql.store_view(tx, number, view)
            sql.store_events(tx, number, data)
            camera_sql.store_cancellation(tx, number, after.id)
            tx.announce(after.id)

        await self._write(work)

    async def load_record(self, owner: str, session_id: str, known: Record | None) -> Record:
        columns = await self._database.read(lambda tx: sql.read_record(tx, owner, session_id, known))
        if columns is None:
            assert known is not None
            return known
        usable = None if columns.scene is not None else known
        return await self._encode(lambda: rows.record_from_columns(columns, usable))

    async def load_session(self, owner: str, session_id: str) -> Snapshot:
        def work(tx: Transaction) -> tuple[dict[str, Any], bytes]:
            found = sql.find(tx, owner, session_id)
            return found, sql.read_view(tx, found["number"])

        row, view = await self._database.read(work)
        session = await self._encode(lambda: rows.session_from_view(view))
        return Snapshot(session, row["version"], row["last_event"])

    async def load_camera(self, owner: str, camera_id: str) -> CameraMemory | None:
        columns = await self._database.read(lambda tx: camera_sql.read_camera(tx, owner, camera_id))
        return None if columns is None else await self._encode(lambda: camera_rows.memory_from_columns(columns))

    async def list_cameras(self, owner: str) -> list[CameraSummary]:
        found = await self._database.read(
            lambda tx: tx.execute("SELECT id, sessions, summary FROM camera WHERE owner = :owner", {"owner": owner})
        )
        return sorted(map(camera_rows.summary_from_row, found), key=lambda camera: camera.id)

    async def forget_camera(self, owner: str, camera_id: str) -> None:
        if not await self._write(lambda tx: camera_sql.forget_camera(tx, owner, camera_id)):
            raise camera_sql.unknown_camera(camera_id)

    async def is_present(self, record: Record) -> bool:
        values = {"id": record.id, "version": record.version}
        statement = "SELECT 1 FROM session WHERE id = :id AND version = :version"
        return bool(await self._database.read(lambda tx: tx.execute(statement, values)))

    async def list_sessions(self, owner: str, limit: int, before: int | None) -> tuple[list[Session], int | None]:
        values = {"owner": owner, "before": 2**63 - 1 if before is None else before, "limit": limit + 1}
        found = await self._database.read(
            lambda tx: tx.execute(
                "SELECT number, message FROM session JOIN view ON view.session = number "
                "WHERE owner = :owner AND number < :before ORDER BY number DESC LIMIT :limit",
                values,
            )
        )
        kept = found[:limit]
        sessions = await self._encode(lambda: [rows.session_from_view(row["message"]) for row in kept])
        return sessions, kept[-1]["number"] if len(found) > limit else None

    async def load_events(self, session_id: str, after: int, without: str = "") -> list[Event]:
        def work(tx: Transaction) -> list[Any]:
            found = tx.execute("SELECT number FROM session WHERE id = :id", {"id": session_id})
            if not found:
                raise sql.not_found(session_id)
            return tx.execute(
                "SELECT id, type, data FROM event "
                "WHERE session = :number AND id > :after AND type <> :without ORDER BY id",
                {"number": found[0]["number"], "after": after, "without": without},
            )

        found = await self._database.read(work)
        return await self._encode(lambda: [Event(row["type"], json.loads(row["data"]), row["id"]) for row in found])

    async def find_keyed(self, owner: str, key: str) -> tuple[KeyedRequest, str] | None:
        found = await self._database.read(
            lambda tx: tx.execute(
                "SELECT fingerprint, id FROM idempotency_key AS k JOIN session ON number = session "
                "WHERE k.owner = :owner AND key = :key AND k.created > epoch() - :lifetime",
                {"owner": owner, "key": key, "lifetime": sql.KEY_LIFETIME},
            )
        )
        return (KeyedRequest(key, found[0]["fingerprint"]), found[0]["id"]) if found else None

    async def acquire_lease(self, name: str, holder: str, seconds: float) -> bool:
        values = {"name": name, "holder": holder, "seconds": seconds}
        statement = (
            "INSERT INTO lease (name, holder, until) VALUES (:name, :holder, epoch() + :seconds) "
            "ON CONFLICT (name) DO UPDATE SET holder = excluded.holder, until = excluded.until "
            "WHERE lease.until <= epoch() OR lease.holder = excluded.holder RETURNING name"
        )
        return bool(await self._write(lambda tx: tx.execute(statement, values)))

    async def renew_leases(self, holders: Sequence[str], seconds: float) -> None:
        def work(tx: Transaction) -> None:
            for holder in sorted(holders):
                tx.execute(
                    "UPDATE lease SET until = epoch() + :seconds WHERE holder = :holder",
                    {"holder": holder, "seconds": seconds},
                )

        await self._write(work)

    async def release_lease(self, name: str, holder: str) -> None:
        await self._write(lambda tx: sql.release_lease(tx, name, holder))

    async def find_ended(self, limit: int, untouched: float | None) -> list[Owned]:
        return await self._find_oldest(1, limit, untouched or 0.0)

    async def find_abandoned(self, limit: int, untouched: float) -> list[Owned]:
        return await self._find_oldest(0, limit, untouched)

    async def remove(self, owner: str, session_id: str) -> None:
        def work(tx: Transaction) -> None:
            values = {"owner": owner, "id": session_id}
            removed = tx.execute("DELETE FROM session WHERE id = :id AND owner = :owner RETURNING scene", values)
            for row in removed:
                tx.execute(
                    "DELETE FROM scene WHERE digest = :scene "
                    "AND NOT EXISTS (SELECT 1 FROM session WHERE session.scene = :scene)",
                    {"scene": row["scene"]},
                )
                tx.announce(session_id)

        await self._write(work)

    async def tidy(self) -> None:
        def work(tx: Transaction) -> None:
            tx.execute(
                "DELETE FROM idempotency_key WHERE created <= epoch() - :lifetime", {"lifetime": sql.KEY_LIFETIME}
            )
            tx.execute("DELETE FROM lease WHERE until < epoch() - 60")

        await self._write(work)
        await self._database.shrink()

    async def used_bytes(self) -> int:
        found = await self._database.read(
            lambda tx: tx.execute(
                "SELECT CAST((SELECT coalesce(sum(size), 0) FROM session) + (SELECT coalesce(sum(size), 0) FROM scene) "
                "AS BIGINT) AS used"
            )
        )
        return int(found[0]["used"])

    async def check(self) -> None:
        self._database.check_disk()
        if not self._in_doubt and time.monotonic() < self._checked + _FRESH:
            return
        values = {"ballast": os.urandom(_BALLAST if self._in_doubt else 1)}
        statement = (
            "INSERT INTO heartbeat (id, at, ballast) VALUES (0, epoch(), :ballast) "
            "ON CONFLICT (id) DO UPDATE SET at = excluded.at, ballast = excluded.ballast"
        )
        await self._write(lambda tx: tx.execute(statement, values), patient=False)
        self._in_doubt, self._checked = False, time.monotonic()

    def close(self) -> None:
        self._codec.shutdown()

    async def _write(self, work: Callable[[Transaction], T], *, patient: bool = True) -> T:
        """What `work` returns; after a failure checks are thorough until one succeeds."""
        try:
            return await self._database.write(work, patient=patient)
        except Unavailable:
            self._in_doubt = True
            raise

    async def _find_oldest(self, ended: int, limit: int, untouched: float) -> list[Owned]:
        found = await self._database.read(
            lambda tx: tx.execute(
                "SELECT owner, id FROM session WHERE ended = :ended AND touched <= epoch() - :untouched "
                "ORDER BY touched, number LIMIT :limit",
                {"ended": ended, "untouched": untouched, "limit": limit},
            )
        )
        return [Owned(row["owner"], row["id"]) for row in found]

    async def _encode(self, convert: Callable[[], T]) -> T:
        """What `convert` returns, which encodes or decodes messages."""
        return await asyncio.get_running_loop().run_in_executor(self._codec, convert)
