-- What is learned of cameras that sessions name. It outlives the sessions.
ALTER TABLE session ADD COLUMN camera TEXT NOT NULL DEFAULT ''; -- id of its camera; empty: none was named

CREATE TABLE camera (
    owner TEXT NOT NULL,
    id TEXT NOT NULL,
    believed BLOB NOT NULL, -- pretouch.v1.Pose: base_T_camera of the newest session
    sessions INTEGER NOT NULL, -- that counted, also those whose observations are gone
    last INTEGER NOT NULL, -- number of the newest observation that counts; 0: none
    summary BLOB NOT NULL, -- pretouch.v1.CameraSummary: what follows from the observations up to the last
    PRIMARY KEY (owner, id)
) STRICT, WITHOUT ROWID;

CREATE TABLE observation (
    number INTEGER PRIMARY KEY AUTOINCREMENT, -- order in which the sessions ended
    owner TEXT NOT NULL,
    camera TEXT NOT NULL,
    session TEXT NOT NULL, -- its id; the session itself may be removed by now
    at REAL NOT NULL, -- when it ended, s since the Unix epoch
    counts INTEGER NOT NULL, -- 0 or 1
    reason TEXT NOT NULL, -- why it does not count; empty if it does
    message BLOB NOT NULL, -- pretouch.v1.CameraObservation; empty if it does not count
    FOREIGN KEY (owner, camera) REFERENCES camera (owner, id) ON DELETE CASCADE
) STRICT;
CREATE INDEX observation_by_camera ON observation (owner, camera, counts, number);
