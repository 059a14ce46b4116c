-- Blobs are messages of proto/pretouch/v1, serialised: they keep every number to the bit.
CREATE TABLE session (
    number INTEGER PRIMARY KEY AUTOINCREMENT, -- order of creation
    id TEXT NOT NULL UNIQUE,
    created REAL NOT NULL, -- s since the Unix epoch
    request BLOB NOT NULL, -- pretouch.v1.CreateSessionRequest, its depth left empty
    scene BLOB NOT NULL, -- pretouch.v1.Scene
    origin TEXT NOT NULL, -- JSON [u0, v0]
    view BLOB NOT NULL, -- pretouch.v1.Session: what the client sees
    skipped TEXT NOT NULL, -- JSON list of region ids
    answered TEXT NOT NULL -- JSON list of scan ids
) STRICT;

CREATE TABLE scan (
    session INTEGER NOT NULL REFERENCES session (number) ON DELETE CASCADE,
    position INTEGER NOT NULL, -- 0, 1, ... in the order of the session's scans
    beams BLOB NOT NULL, -- pretouch.v1.Scan
    PRIMARY KEY (session, position)
) STRICT, WITHOUT ROWID;

CREATE TABLE event (
    session INTEGER NOT NULL REFERENCES session (number) ON DELETE CASCADE,
    id INTEGER NOT NULL, -- 1, 2, ... within the session
    type TEXT NOT NULL,
    data TEXT NOT NULL, -- JSON
    PRIMARY KEY (session, id)
) STRICT, WITHOUT ROWID;

CREATE TABLE idempotency_key (
    key TEXT PRIMARY KEY,
    fingerprint TEXT NOT NULL, -- SHA-256 of the request that the key came with
    session INTEGER NOT NULL REFERENCES session (number) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
