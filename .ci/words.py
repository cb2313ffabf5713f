"""Check the English: `python .ci/words.py [FILE|FOLDER…]` counts words that are not plain, and finds long sentences in pages.

It fails above `LIMIT` words, and for a sentence with more than `LONGEST` words in Markdown of the top level or docs/.
"""

import re
import sys
from pathlib import Path

LIMIT = 250
"""Banned words in the whole repository. Lower it when the count falls; never raise it."""
LONGEST = 35
BANNED = re.compile(
    r"\b(told|tells?|stands?|stood|beside|hangs?|hung|hanging|worth|whoever|whatever|anew|go(es)? by|as it is|as they are"
    r"|taken for|drawn back|(un)?tare[ds]?|taring|knees?|swallow(s|ed|ing)?|lean(s|ed|ing)? on|comes? to nothing|one that"
    r"|of (its|their) own|by hand|left alone|makes? up|let alone|in the way of|there is to|what is left|what it is"
    r"|(there|where)of|wherein|thereby|goes on|there, too|at all)\b",
    re.IGNORECASE,
)
KINDS = ("*.py", "*.md", "*.j2", "*.html")
ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = {".venv", ".venv-lowest", "build", "runs", "__pycache__", ".git"}


def files(paths: list[Path]) -> list[Path]:
    """List Python, Markdown and template files once, without this one."""
    found = {p.resolve() for path in paths for kind in KINDS for p in ([path] if path.is_file() else path.rglob(kind))}
    return sorted(p for p in found - {Path(__file__).resolve()} if not LEFT_OUT & {*p.relative_to(ROOT).parts})


def sentences(text: str) -> list[str]:
    """Split a page's prose into sentences, without code, tables and comments."""
    text = re.sub(r"```.*?```|<!-- .*? -->", "", text, flags=re.DOTALL)
    prose = [line for line in re.sub(r"\]\([^)]*\)", "]", text).splitlines() if not re.match(r"\||#|    |!\[", line)]
    joined = "\n".join(re.sub(r"^\s*([*-]|\d+\.)\s", "\n\n", line) for line in prose)
    paragraphs = (" ".join(part.split()) for part in joined.split("\n\n"))
    return [s for p in paragraphs for s in re.split(r"(?<=[.!?])(?:\*\*)?\s+(?=[A-Z`*\[])", p)]


def main() -> int:
    """Print what was found; return 1 if it is too much."""
    counts = {p: len(BANNED.findall(p.read_text("utf-8"))) for p in files([Path(a) for a in sys.argv[1:]] or [ROOT])}
    for path, count in sorted(counts.items(), key=lambda one: -one[1])[: None if sys.argv[1:] else 5]:
        print(f"{path.relative_to(ROOT)}: {count}")
    pages = [p for p in counts if p.suffix == ".md" and p.parent in (ROOT, ROOT / "docs")]
    long = [(p, s) for p in pages for s in sentences(p.read_text("utf-8")) if len(s.split()) > LONGEST]
    for path, sentence in long:
        print(f"{path.relative_to(ROOT)}: {len(sentence.split())} words in one sentence: {sentence[:90]}…")
    total = sum(counts.values())
    print(f"{total} banned words in {len(counts)} files (at most {LIMIT}); {len(long)} sentences over {LONGEST} words")
    return int(total > LIMIT or bool(long))


if __name__ == "__main__":
    sys.exit(main())
