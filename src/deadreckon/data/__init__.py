"""The log: columns and spec, readers and writers, the catalogue. Knows no method and no simulator."""
