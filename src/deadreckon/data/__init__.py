"""The log: columns and spec, readers and writers, and the catalogue; independent of methods and simulators."""
