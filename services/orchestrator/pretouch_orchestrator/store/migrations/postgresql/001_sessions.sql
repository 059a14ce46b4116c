-- Blobs are messages of proto/pretouch/v1, serialised: they keep every number to the bit.
-- Times are s since the Unix epoch.
CREATE FUNCTION epoch() RETURNS DOUBLE PRECISION LANGUAGE sql VOLATILE
AS 'SELECT CAST(extract(epoch FROM clock_timestamp()) AS DOUBLE PRECISION)';

CREATE TABLE scene (
    digest BYTEA PRIMARY KEY, -- of the content: pretouch.scene.Scene.digest
    size BIGINT NOT NULL, -- of the message, bytes
    message BYTEA NOT NULL -- pretouch.v1.Scene
);
ALTER TABLE scene ALTER COLUMN message SET STORAGE EXTERNAL; -- depth hardly compresses

CREATE TABLE session (
    number BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY, -- order of creation
    id TEXT NOT NULL UNIQUE,
    owner TEXT NOT NULL,
    created DOUBLE PRECISION NOT NULL,
    request BYTEA NOT NULL, -- pretouch.v1.CreateSessionRequest, its depth left empty
    scene BYTEA NOT NULL REFERENCES scene (digest),
    origin TEXT NOT NULL, -- JSON [u0, v0]
    version BIGINT NOT NULL, -- counts the states; an update names the one that it was computed from
    touched DOUBLE PRECISION NOT NULL, -- when the state last changed
    ended SMALLINT NOT NULL, -- 0 or 1
    last_event BIGINT NOT NULL, -- id of the newest event
    size BIGINT NOT NULL, -- bytes that were written for it, its scene left out
    skipped TEXT NOT NULL, -- JSON list of region ids
    answered TEXT NOT NULL -- JSON list of scan ids
);
CREATE INDEX scene_by_size ON scene (size);
CREATE INDEX session_by_scene ON session (scene);
CREATE INDEX session_by_age ON session (ended, touched, size);
CREATE INDEX session_by_owner ON session (owner, number);

CREATE TABLE view (
    session BIGINT PRIMARY KEY REFERENCES session (number) ON DELETE CASCADE,
    message BYTEA NOT NULL -- pretouch.v1.Session: what the client sees
);

CREATE TABLE scan (
    session BIGINT NOT NULL REFERENCES session (number) ON DELETE CASCADE,
    position BIGINT NOT NULL, -- 0, 1, ... in the order of the session's scans
    beams BYTEA NOT NULL, -- pretouch.v1.Scan
    PRIMARY KEY (session, position)
);

-- Samples of the session's next scan that were told while the robot moves; they go when the scan is closed.
CREATE TABLE told (
    session BIGINT NOT NULL REFERENCES session (number) ON DELETE CASCADE,
    position BIGINT NOT NULL, -- 0, 1, ... in the order in which they were told
    samples BYTEA NOT NULL, -- pretouch.v1.Samples
    PRIMARY KEY (session, position)
);

CREATE TABLE event (
    session BIGINT NOT NULL REFERENCES session (number) ON DELETE CASCADE,
    id BIGINT NOT NULL, -- 1, 2, ... within the session
    type TEXT NOT NULL,
    data TEXT NOT NULL, -- JSON
    PRIMARY KEY (session, id)
);

CREATE TABLE idempotency_key (
    owner TEXT NOT NULL,
    key TEXT NOT NULL,
    fingerprint TEXT NOT NULL, -- SHA-256 of the request that the key came with
    session BIGINT NOT NULL REFERENCES session (number) ON DELETE CASCADE,
    created DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (owner, key)
);
CREATE INDEX idempotency_key_by_session ON idempotency_key (session);

-- Who works on what: until then nobody else does, unless the holder lets go of it.
CREATE TABLE lease (
    name TEXT PRIMARY KEY,
    holder TEXT NOT NULL,
    until DOUBLE PRECISION NOT NULL
);

-- One row, written to find out whether the store can be written.
CREATE TABLE heartbeat (
    id SMALLINT PRIMARY KEY,
    at DOUBLE PRECISION NOT NULL,
    ballast BYTEA NOT NULL
);
