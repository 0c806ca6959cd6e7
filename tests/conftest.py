import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def realdata() -> Path:
    """Folder of the real recordings, which do not ship with the library."""
    folder = Path(os.environ.get("SIM2REAL_REALDATA", ROOT.parent / "shared" / "realdata"))
    if not folder.is_dir():
        pytest.skip(f"no real recordings in {folder}; SIM2REAL_REALDATA can say where they are")
    return folder


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``datasets`` and ``reports`` as in a clone, but short recordings.

    Seven seconds of each on the bench, ten of each swim. For tests of whole chains, whose time is
    that of simulating recordings.
    """
    folder = tmp_path_factory.mktemp("short")
    (folder / "reports").symlink_to(ROOT / "reports")
    for name, samples in (("servo_steps", 250), ("pool", 500)):
        (folder / "datasets" / name).mkdir(parents=True)
        for path in (ROOT / "datasets" / name).iterdir():
            here = folder / "datasets" / name / path.name
            if path.suffix == ".csv":
                here.write_text("".join(path.read_text().splitlines(keepends=True)[: samples + 1]))
            else:
                here.symlink_to(path)
    return folder
