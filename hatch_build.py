"""What a package index shows of README.md, whose links are relative because it is read in the repository.

They become absolute under the repository's address, `repository` in `[tool.hatch.metadata.hooks.custom]` of pyproject.toml. As
long as that is empty, since the repository is not public, texts of links stay without their links, and pictures are left out.
"""

import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^()\s]+)\)")
_ELSEWHERE = re.compile(r"[a-z][a-z0-9+.-]*:|#")  # addresses, and places on the same page


def for_an_index(text: str, repository: str, version: str) -> str:
    """The text of README.md for readers who have no repository beside it.

    Args:
        text: Markdown with links relative to the repository.
        repository: its address, such as https://github.com/user/name, or "".
        version: whose tag `vVERSION` links lead to.
    """

    def changed(link: re.Match[str]) -> str:
        picture, words, target = link.groups()
        if _ELSEWHERE.match(target):
            return link[0]
        if not repository:
            return "" if picture else words
        return f"{picture}[{words}]({repository.rstrip('/')}/{'raw' if picture else 'blob'}/v{version}/{target})"

    return re.sub(r"\n{3,}", "\n\n", _LINK.sub(changed, text))


class CustomMetadataHook(MetadataHookInterface):
    """Gives the text to the metadata of wheel and source distribution."""

    def update(self, metadata: dict) -> None:
        """See hatchling."""
        root = Path(self.root)
        version = re.search(r'"(.+)"', (root / "src/deadreckon/_version.py").read_text(encoding="utf-8"))
        assert version is not None
        text = (root / "README.md").read_text(encoding="utf-8")
        told = for_an_index(text, self.config["repository"], version[1])
        metadata["readme"] = {"content-type": "text/markdown", "text": told}
