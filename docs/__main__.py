"""One command makes the site: ``python -m docs [FOLDER] [--gallery [STUDY ...]]``.

Pages that come from the code (reference, commands, gallery, the drawing of the house) and the pages of this folder are
staged in FOLDER/source, and Sphinx makes FOLDER/html of them, without a network; a warning is an error. With
``--gallery`` the case studies and their tests run first, all or those that are named, and their records are kept in
``docs/gallery``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from docs.making import site


def main(words: list[str] | None = None) -> int:
    """Stage and build; 0 where nothing is wrong."""
    parser = argparse.ArgumentParser(prog="python -m docs", description="Make the documentation site.")
    parser.add_argument("folder", nargs="?", default="build/docs", type=Path, help="where to; default build/docs")
    parser.add_argument("--gallery", nargs="*", metavar="STUDY", help="run case studies and their tests first")
    args = parser.parse_args(words)
    if args.gallery is not None:
        from docs.making import gallery

        gallery.record(args.gallery)
    site.stage(args.folder / "source")
    return site.build(args.folder / "source", args.folder / "html")


if __name__ == "__main__":
    sys.exit(main())
