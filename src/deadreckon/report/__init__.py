"""From run folders to one HTML page (`write`), a table for the terminal (`table`) and one sentence (`headline`).

`picture` draws learning curves of many runs as one SVG file.
"""

from deadreckon.report.page import write
from deadreckon.report.picture import picture
from deadreckon.report.terminal import headline, table

__all__ = ["headline", "picture", "table", "write"]
