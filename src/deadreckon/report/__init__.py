"""From run folders to one HTML page (`write`), a table for the terminal (`table`) and one sentence (`headline`)."""

from deadreckon.report.page import write
from deadreckon.report.terminal import headline, table

__all__ = ["headline", "table", "write"]
