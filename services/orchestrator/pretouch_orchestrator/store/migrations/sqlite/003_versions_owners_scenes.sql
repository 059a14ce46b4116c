-- Scenes are stored once, by content. Sessions have an owner, and a version that fences their steps.
CREATE TABLE scene (
    digest BLOB PRIMARY KEY, -- of the content: pretouch.scene.Scene.digest
    size INTEGER NOT NULL, -- of the message, bytes
    message BLOB NOT NULL -- pretouch.v1.Scene
) STRICT;

INSERT OR IGNORE INTO scene (digest, size, message) SELECT scene_digest(scene), length(scene), scene FROM session;

CREATE TABLE new_session (
    number INTEGER PRIMARY KEY AUTOINCREMENT, -- order of creation
    id TEXT NOT NULL UNIQUE,
    owner TEXT NOT NULL,
    created REAL NOT NULL, -- s since the Unix epoch
    request BLOB NOT NULL, -- pretouch.v1.CreateSessionRequest, its depth left empty
    scene BLOB NOT NULL REFERENCES scene (digest),
    origin TEXT NOT NULL, -- JSON [u0, v0]
    version INTEGER NOT NULL, -- counts the states; an update names the one that it was computed from
    touched REAL NOT NULL, -- when the state last changed, s since the Unix epoch
    ended INTEGER NOT NULL, -- 0 or 1
    last_event INTEGER NOT NULL, -- id of the newest event
    size INTEGER NOT NULL, -- bytes that were written for it, its scene left out
    skipped TEXT NOT NULL, -- JSON list of region ids
    answered TEXT NOT NULL -- JSON list of scan ids
) STRICT;

INSERT INTO new_session
SELECT
    number, id, '', created, request, scene_digest(scene), origin, 1, created, view_ended(view),
    (SELECT coalesce(max(event.id), 0) FROM event WHERE event.session = number),
    length(request) + length(view)
    + (SELECT coalesce(sum(length(beams)), 0) FROM scan WHERE scan.session = number)
    + (SELECT coalesce(sum(length(data)), 0) FROM event WHERE event.session = number)
    + (SELECT coalesce(sum(length(samples)), 0) FROM told WHERE told.session = number),
    skipped, answered
FROM session ORDER BY number;

-- What the client sees: apart, so that a change of version does not write it anew.
CREATE TABLE view (
    session INTEGER PRIMARY KEY REFERENCES session (number) ON DELETE CASCADE,
    message BLOB NOT NULL -- pretouch.v1.Session
) STRICT;

INSERT INTO view (session, message) SELECT number, view FROM session;

CREATE TABLE new_idempotency_key (
    owner TEXT NOT NULL,
    key TEXT NOT NULL,
    fingerprint TEXT NOT NULL, -- SHA-256 of the request that the key came with
    session INTEGER NOT NULL REFERENCES session (number) ON DELETE CASCADE,
    created REAL NOT NULL, -- s since the Unix epoch
    PRIMARY KEY (owner, key)
) STRICT, WITHOUT ROWID;

INSERT INTO new_idempotency_key (owner, key, fingerprint, session, created)
SELECT '', key, fingerprint, session, created FROM idempotency_key JOIN session ON number = session;

DROP TABLE idempotency_key;
DROP TABLE session;
ALTER TABLE new_session RENAME TO session;
ALTER TABLE new_idempotency_key RENAME TO idempotency_key;
CREATE INDEX scene_by_size ON scene (size);
CREATE INDEX session_by_scene ON session (scene);
CREATE INDEX session_by_age ON session (ended, touched, size);
CREATE INDEX session_by_owner ON session (owner, number);
CREATE INDEX idempotency_key_by_session ON idempotency_key (session);

-- Who works on what: until then nobody else does, unless the holder lets go of it.
CREATE TABLE lease (
    name TEXT PRIMARY KEY,
    holder TEXT NOT NULL,
    until REAL NOT NULL -- s since the Unix epoch
) STRICT, WITHOUT ROWID;

-- One row, written to find out whether the store can be written.
CREATE TABLE heartbeat (
    id INTEGER PRIMARY KEY,
    at REAL NOT NULL, -- s since the Unix epoch
    ballast BLOB NOT NULL
) STRICT;
