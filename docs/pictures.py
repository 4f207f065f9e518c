"""Makes the pictures and films of README.md, the site and the gallery, and the outputs of the notebooks.

    python docs/pictures.py                        # all, by the commands of docs/pictures.toml; about 10 minutes
    python docs/pictures.py docs/apartment.png     # some, by their files
    python docs/pictures.py --check                # make them elsewhere, and say which differ from those kept

Each PNG carries its command and the commit of the code as text ("Command", "Commit"), those in a notebook, too. One
that names a page in `quoted` has what the command printed as well ("Output"). The same takes the place of the block of
that page which a comment with the picture's file marks. What needs data or programs that are not here is left as it is,
and said. Comparing belongs to a release: other versions draw other pixels.
"""

from __future__ import annotations

import argparse
import base64
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps
from PIL.PngImagePlugin import PngInfo

ROOT = Path(__file__).resolve().parents[1]
REGISTRY = ROOT / "docs" / "pictures.toml"
CODE_FOLDERS = ("sixthsense", "scenes", "docs/drawn")
WIDGET = "application/vnd.jupyter.widget-view+json"

COLORS = 256
"""of a PNG: a palette keeps the repository small"""
COMPARED = (350, 250)
"""pixels of a picture that is compared: lines that move by one pixel of the original do not count"""
DIFFERENT = 40
"""grey levels of 255 by which a compared pixel differs"""
MOST_DIFFERENT = 0.02
"""share of such pixels in two pictures that are the same"""


@dataclass(frozen=True, slots=True)
class Picture:
    """A file of the repository and what makes it."""

    file: str
    made: str = ""
    """the file that the commands make; none for a notebook, which is run in its place"""
    commands: tuple[str, ...] = ()
    page: str = ""
    """the page of docs/ whose code makes it, in place of commands"""
    needs: tuple[str, ...] = ()
    """files in the folder SIXTHSENSE_DATA"""
    quoted: str = ""
    """a page of docs/ that has what the commands print"""
    uses: tuple[str, ...] = ()
    """programs and modules beyond those of the extras dev and docs"""

    @property
    def command(self) -> str:
        """What the picture carries."""
        if self.is_notebook:
            return f"python docs/pictures.py {self.file}"
        return " && ".join(self.commands) or f"the code of docs/{self.page}"

    @property
    def is_notebook(self) -> bool:
        """Whether it is run in its place, and its pictures are those in its outputs."""
        return self.file.endswith(".ipynb")

    def missing(self) -> list[str]:
        """What is needed and not here."""
        data = os.environ.get("SIXTHSENSE_DATA", "")
        files = [f"{name} in SIXTHSENSE_DATA" for name in self.needs if not data or not (Path(data) / name).exists()]
        return [*files, *(name for name in self.uses if shutil.which(name) is None and find_spec(name) is None)]


def pictures() -> list[Picture]:
    """The registry: its pictures, and every notebook."""
    registry = tomllib.loads(REGISTRY.read_text(encoding="utf-8"))
    entries = [
        Picture(**{name: tuple(v) if isinstance(v, list) else v for name, v in e.items()}) for e in registry["picture"]
    ]
    files = sorted(file.relative_to(ROOT).as_posix() for file in ROOT.glob(registry["notebooks"]["files"]))
    return [*entries, *(Picture(file, needs=tuple(registry["notebooks"]["needs"].get(file, ()))) for file in files)]


def run(command: str, folder: Path) -> str:
    """One command in a folder, with this Python, and with paths of the repository in full; what it prints."""
    program, *words = shlex.split(os.path.expandvars(command))
    words = [str(ROOT / word) if word.startswith("docs/") else word for word in words]
    own = sys.executable if program == "python" else str(Path(sys.executable).with_name(program))
    return subprocess.run([own, *words], cwd=folder, check=True, stdout=subprocess.PIPE, text=True).stdout


def make(picture: Picture, folder: Path, done: dict[str, str]) -> Path:
    """Run what is not `done`; the file made."""
    for command in picture.commands:
        if command not in done:
            done[command] = run(command, folder)
    if picture.page:
        sys.path.insert(0, str(ROOT / "docs" / "hooks"))
        from page_code import script

        code, program = script(picture.page, folder), folder / "page.py"
        program.write_text(code, encoding="utf-8")
        run(f"python {program}", folder)
    return folder / picture.made


def stamped(content: bytes, command: str, output: str = "") -> bytes:
    """A PNG with a palette, its command, what that printed, and the commit."""
    text, small = PngInfo(), io.BytesIO()
    if output:
        text.add_text("Output", output)
    text.add_text("Command", command)
    text.add_text("Commit", commit())
    with Image.open(io.BytesIO(content)) as image:
        palette = image if image.mode == "P" else image.convert("RGB").quantize(COLORS, dither=Image.Dither.NONE)
        palette.save(small, "PNG", optimize=True, pnginfo=text)
    return small.getvalue()


def commit() -> str:
    """The last commit that changed the code."""
    git = ["git", "-C", str(ROOT), "log", "-1", "--format=%h", "--abbrev=10", "--", *CODE_FOLDERS]
    return subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()


def executed(notebook: Picture) -> Any:
    """The notebook with the outputs of a run; sliders are left out, since no kernel moves them in a file."""
    import nbformat
    from nbclient import NotebookClient

    content = nbformat.read(ROOT / notebook.file, as_version=4)
    where = {"metadata": {"path": str(ROOT / "notebooks")}}
    NotebookClient(content, timeout=600, record_timing=False, store_widget_state=False, resources=where).execute()
    for cell in content.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if WIDGET not in output.get("data", {})]
            for output in cell.outputs:
                if "image/png" in output.get("data", {}):
                    png = stamped(base64.b64decode(output.data["image/png"]), notebook.command)
                    output.data["image/png"] = base64.b64encode(png).decode()
    return content


def shown(content: Any) -> list[bytes]:
    """The pictures in the outputs of a notebook."""
    outputs = [output for cell in content.cells for output in cell.get("outputs", [])]
    return [base64.b64decode(o.data["image/png"]) for o in outputs if "image/png" in o.get("data", {})]


def frames(image: Image.Image) -> list[np.ndarray]:
    """First and last frame, grey and small."""
    found = []
    for k in sorted({0, getattr(image, "n_frames", 1) - 1}):
        image.seek(k)
        found.append(np.asarray(ImageOps.grayscale(image.convert("RGB")).resize(COMPARED), dtype=np.int64))
    return found


def difference(one: bytes, other: bytes) -> float:
    """Share of the pixels that differ; 1 for pictures of other shapes."""
    with Image.open(io.BytesIO(one)) as a, Image.open(io.BytesIO(other)) as b:
        if abs(a.width / a.height - b.width / b.height) > 0.02 * a.width / a.height:
            return 1.0
        pairs = zip(frames(a), frames(b), strict=True)
        return max(float(np.mean(np.abs(a - b) > DIFFERENT)) for a, b in pairs)


def quoted(page: str, file: str) -> re.Match[str]:
    """The block of a page that quotes what the commands of a picture print."""
    block = rf"(?<=<!-- output of {re.escape(file)} -->\n\n```text\n)(.*?)(?=```\n)"
    found = re.search(block, page, re.DOTALL)
    assert found is not None, f"no block of {file}"
    return found


def keep(picture: Picture, folder: Path, done: dict[str, str]) -> None:
    """Make the picture and put it into its place, and what its commands print."""
    kept = ROOT / picture.file
    if picture.is_notebook:
        import nbformat

        nbformat.write(executed(picture), kept)
        return
    made = make(picture, folder, done).read_bytes()
    output = "".join(done[command] for command in picture.commands) if picture.quoted else ""
    kept.write_bytes(stamped(made, picture.command, output) if kept.suffix == ".png" else made)
    if picture.quoted:
        file = ROOT / "docs" / picture.quoted
        page = file.read_text(encoding="utf-8")
        begin, end = quoted(page, picture.file).span()
        file.write_text(page[:begin] + output + page[end:], encoding="utf-8")


def check(picture: Picture, folder: Path, done: dict[str, str]) -> float:
    """Make the picture elsewhere: share of its pixels that differ from those kept; of a notebook's, the largest."""
    if not picture.is_notebook:
        return difference(make(picture, folder, done).read_bytes(), (ROOT / picture.file).read_bytes())
    import nbformat

    now, kept = shown(executed(picture)), shown(nbformat.read(ROOT / picture.file, as_version=4))
    return 1.0 if len(now) != len(kept) else max(map(difference, now, kept), default=0.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", metavar="FILE", help="only these, files of the registry or notebooks (all)")
    parser.add_argument("--check", action="store_true", help="compare, and change nothing")
    options = parser.parse_args()
    known = {picture.file: picture for picture in pictures()}
    if unknown := [file for file in options.files if file not in known]:
        parser.error(f"file: found {unknown[0]!r}, allowed: {', '.join(known)}")
    os.environ |= {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "SIXTHSENSE_LONG": "1"}
    differing = []
    with tempfile.TemporaryDirectory() as folder:
        done: dict[str, str] = {}
        for name in options.files or known:
            if missing := known[name].missing():
                print(f"{name}: left as it is, missing: {', '.join(missing)}", flush=True)
            elif options.check:
                share = check(known[name], Path(folder), done)
                differing += [name] if share > MOST_DIFFERENT else []
                print(f"{name}: {100 * share:.1f} % of the pixels differ", flush=True)
            else:
                keep(known[name], Path(folder), done)
                print(f"{name}  {(ROOT / name).stat().st_size / 1000:.0f} kB", flush=True)
    if differing:
        print(f"differ: {', '.join(differing)}")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
