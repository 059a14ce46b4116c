-- Samples of the session's next scan that were told while the robot moves; they go when the scan is closed.
CREATE TABLE told (
    session INTEGER NOT NULL REFERENCES session (number) ON DELETE CASCADE,
    position INTEGER NOT NULL, -- 0, 1, ... in the order in which they were told
    samples BLOB NOT NULL, -- pretouch.v1.Samples
    PRIMARY KEY (session, position)
) STRICT, WITHOUT ROWID;
