"""Words of a page as one reads them."""

from __future__ import annotations

import re
from pathlib import Path


def read_page(page: Path) -> str:
    """Read the words of a page, without tags and scripts."""
    body = page.read_text(encoding="utf-8").partition("<body>")[2]
    return re.sub(r"<[^>]*>", " ", re.sub(r"<script.*?</script>", " ", body, flags=re.DOTALL))
