CREATE TABLE experiment (
    key TEXT PRIMARY KEY,
    value TEXT NOT NULL                       -- JSON
) WITHOUT ROWID;
CREATE TABLE candidates (
    id INTEGER PRIMARY KEY,                   -- in the order of proposal, from 0
    generation INTEGER NOT NULL,              -- from 0
    body TEXT NOT NULL,                       -- JSON, rows of cell types, the top row first
    origin TEXT NOT NULL,                     -- how the search made it
    seed INTEGER NOT NULL,                    -- of its training
    fitness REAL,                             -- best deterministic return; NULL until it is evaluated
    steps INTEGER,                            -- control steps spent on it
    stopped INTEGER,                          -- 1: training ended early; 2: diverged before its first evaluation
    reused INTEGER REFERENCES candidates(id), -- the candidate with the same body whose evaluation this is
    policy TEXT,                              -- file of the policy, relative to the archive
    policy_sha256 TEXT,                       -- of its tensors
    proposed_at TEXT NOT NULL,                -- UTC
    finished_at TEXT,
    seconds REAL                              -- wall time since the batch that ended before its own
);
CREATE INDEX candidates_by_generation ON candidates(generation);
CREATE INDEX candidates_by_body ON candidates(body);
CREATE TABLE parents (
    child INTEGER NOT NULL REFERENCES candidates(id),
    position INTEGER NOT NULL,
    parent INTEGER NOT NULL REFERENCES candidates(id),
    PRIMARY KEY (child, position)
) WITHOUT ROWID;
CREATE TABLE curves (                         -- the learning curve: evaluations during training
    candidate INTEGER NOT NULL REFERENCES candidates(id),
    position INTEGER NOT NULL,
    steps INTEGER NOT NULL,                   -- control steps of training before it
    value REAL NOT NULL,                      -- deterministic return
    PRIMARY KEY (candidate, position)
) WITHOUT ROWID;
CREATE VIEW generations AS
    SELECT generation, COUNT(*) AS designs, COUNT(fitness) AS evaluated, MAX(fitness) AS best, AVG(fitness) AS mean,
           MIN(fitness) AS worst, SUM(steps) AS steps
    FROM candidates GROUP BY generation;
