"""Installation by pip and by colcon (ament_python); files go where ROS 2 looks for them."""

import runpy
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

from setuptools import find_packages, setup

NAME = "pam_antagonist"
ROOT = Path(__file__).resolve().parent

about = runpy.run_path(str(ROOT / NAME / "__init__.py"))
# One table says what can be run; it needs the standard library only.
commands = runpy.run_path(str(ROOT / NAME / "__main__.py"))["COMMANDS"]
# colcon calls this file with "install" or "develop" and puts scripts into lib/pam_antagonist (setup.cfg), where
# ros2 run looks: one for each name. pip builds a wheel, whose scripts land on PATH: pam alone, which takes the names.
by_colcon = {"install", "develop"} & set(sys.argv)
scripts = {name: command.target for name, command in commands.items()} if by_colcon else {}

# Who keeps the package stands in package.xml alone.
maintainer = ET.parse(ROOT / "package.xml").find("maintainer")
assert maintainer is not None


def tree(folder: str, suffixes: tuple[str, ...]) -> list[tuple[str, list[str]]]:
    """``data_files`` entries of a folder and what is below it, under ``share/pam_antagonist``."""
    found: dict[str, list[str]] = {}
    for path in sorted((ROOT / folder).rglob("*")):
        if path.suffix in suffixes and path.is_file():
            relative = path.relative_to(ROOT)
            found.setdefault(f"share/{NAME}/{relative.parent.as_posix()}", []).append(relative.as_posix())
    return list(found.items())


setup(
    name=NAME,
    version=about["__version__"],
    description="Sensor-less angle and torque of a joint that is driven by two pneumatic artificial muscles.",
    long_description=(ROOT / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    maintainer=maintainer.text,
    maintainer_email=maintainer.attrib["email"],
    python_requires=">=3.10",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "report/templates/*", "nodes/*.html"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "LICENSE"]),
        *tree("config", (".json", ".rviz", ".xacro", ".xml", ".yaml")),
        *tree("launch", (".py",)),
        *tree("pam_antagonist_msgs", (".msg",)),
        *tree("urdf", (".xacro",)),
    ],
    install_requires=[
        'backports.zstd>=1; python_version < "3.14"',
        "jinja2>=3.0",
        "joblib>=1.3",
        "lz4>=4",
        "MarkupSafe>=2.0",
        "numba>=0.58",
        "numpy>=1.26,<3",
        "pydantic>=1.10,<3",
        "PyYAML>=6",
        "rosbags>=0.11.9,<0.12",
        "scipy>=1.11",
        "threadpoolctl>=3.8",
        "tqdm>=4.64",
        "typing_extensions>=4.5",
    ],
    extras_require={
        # Scripts for the shell: pam --completion bash.
        "completion": ["shtab>=1.6"],
        # Boosted trees, to compare the measured arm's model with: pamy.
        "compare": ["scikit-learn>=1.3"],
        # Fits of close_loop and identify, cases of battery on the workers of a scheduler.
        "dask": ["dask>=2023.5", "distributed>=2023.5"],
        # The documentation site, ./run docs.
        "docs": ["furo>=2024.8", "latex2mathml>=3.77", "myst-parser>=4", "sphinx>=8"],
        # A microcontroller on a serial port: bridge.
        "hardware": ["pyserial>=3.5"],
        # What import_csv reads beside text: MATLAB 7.3, Parquet. pandas is for results as data frames.
        "import": ["h5py>=3.8", "pandas>=2.0", "pyarrow>=14"],
        # What ours is compared with by the laboratory: peers. torch takes some gigabytes.
        "peers": ["pysindy>=2", "scikit-learn>=1.3", "torch>=2"],
        # Figures of report.html.
        "reports": ["plotly>=5.15"],
        # filterpy is the independent filter that ours is compared with, by a test and by `benchmark`. matplotlib draws
        # the pictures of pages that the laboratory writes.
        "test": [
            "filterpy>=1.4.5,<3",
            "hypothesis>=6.80",
            "matplotlib>=3.6",
            "mypy==2.4.1",
            "Pillow>=9.4",
            "pytest>=7.4",
            "pytest-xdist>=3.8",
            "ruff==0.17.5",
            "types-PyYAML",
        ],
        # The live page: watch.
        "watch": ["tornado>=6.3"],
    },
    entry_points={
        "console_scripts": [
            f"{name} = {target}" for name, target in {"pam": f"{NAME}.__main__:main", **scripts}.items()
        ]
    },
    zip_safe=False,
)
