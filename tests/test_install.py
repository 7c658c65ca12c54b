"""Set-up with uv takes packages from where pip takes them, and pip does the same job where uv cannot."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def install() -> ModuleType:
    spec = importlib.util.spec_from_file_location("install", ROOT / ".ci" / "install.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def list_settings(tmp_path: Path, config: str, **environment: str) -> str:
    """Return what pip itself prints about a configuration file and variables of the environment."""
    (tmp_path / "pip.conf").write_text(config, encoding="utf-8")
    variables = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "XDG_CONFIG_DIRS": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"],
        env=variables | {"PIP_CONFIG_FILE": str(tmp_path / "pip.conf")} | environment,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout


def test_settings_of_pip_reach_uv_without_places_that_do_not_exist(tmp_path: Path, install: ModuleType) -> None:
    for name in ("wheels", "more wheels", "index"):
        (tmp_path / name).mkdir()
    (tmp_path / "limits.txt").write_text("torch<3\n", encoding="utf-8")
    more = (tmp_path / "more wheels").as_uri()
    config = f"""
[global]
find-links = {tmp_path}/wheels
    {more}
    {tmp_path}/missing
constraint = {tmp_path}/limits.txt {tmp_path}/missing.txt
index-url = https://mirror.example/simple
extra-index-url = {(tmp_path / "index").as_uri()} file://{tmp_path}/missing https://more.example/simple
cert = {tmp_path}/missing.pem
timeout = 20
[install]
timeout = 30
[freeze]
timeout = 99
"""
    variables = install.translate_settings(install.read_pip_settings(list_settings(tmp_path, config)))
    assert variables == {
        "UV_FIND_LINKS": f"{tmp_path}/wheels,{more}",
        "UV_CONSTRAINT": f"{tmp_path}/limits.txt",
        "UV_DEFAULT_INDEX": "https://mirror.example/simple",
        "UV_INDEX": f"{(tmp_path / 'index').as_uri()} https://more.example/simple",
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "UV_HTTP_TIMEOUT": "30",
    }


def test_the_environment_overrides_the_files_of_pip(tmp_path: Path, install: ModuleType) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own.pem").touch()
    listing = list_settings(
        tmp_path, f"[global]\nfind-links = {tmp_path}\ncert = {tmp_path}/pip.conf\n",
        PIP_FIND_LINKS=f"{tmp_path}/own", PIP_CERT=f"{tmp_path}/own.pem", PIP_DEFAULT_TIMEOUT="180",
    )  # fmt: skip
    variables = install.translate_settings(install.read_pip_settings(listing))
    assert variables["UV_FIND_LINKS"] == f"{tmp_path}/own"
    assert variables["SSL_CERT_FILE"] == f"{tmp_path}/own.pem"
    assert variables["UV_HTTP_TIMEOUT"] == "180"


def test_uv_takes_the_constrained_version_from_the_folder_that_pip_knows(tmp_path: Path, install: ModuleType) -> None:
    for version in ("1.0", "2.0+cpu", "3.0"):
        write_wheel(tmp_path, version)
    (tmp_path / "limits.txt").write_text("rolling<3\n", encoding="utf-8")
    config = f"[global]\nfind-links = {tmp_path}\nconstraint = {tmp_path}/limits.txt\n"
    variables = install.translate_settings(install.read_pip_settings(list_settings(tmp_path, config)))
    target = tmp_path / "installed"
    if importlib.util.find_spec("uv") is None:
        pytest.skip("uv is not installed here; make test installs it")
    command = [sys.executable, "-m", "uv", "pip", "install", "--no-index", "--target", str(target), "rolling>=1,<=2.0"]
    subprocess.run(command, env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)} | variables, check=True)
    assert (target / "rolling.py").read_text() == "version = '2.0+cpu'"


def write_wheel(folder: Path, version: str) -> None:
    """Write a wheel of one module."""
    from zipfile import ZipFile

    info = f"rolling-{version}.dist-info"
    with ZipFile(folder / f"rolling-{version}-py3-none-any.whl", "w") as wheel:
        wheel.writestr("rolling.py", f"version = '{version}'")
        wheel.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: rolling\nVersion: {version}\n")
        wheel.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr(f"{info}/RECORD", f"rolling.py,,\n{info}/METADATA,,\n{info}/WHEEL,,\n{info}/RECORD,,\n")


@pytest.mark.parametrize(("value", "is_passed"), [("true", True), ("1", True), ("0", False), (None, False)])
def test_uv_asks_no_index_where_pip_asks_none(
    value: str | None, is_passed: bool, install: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    listing, commands = "" if value is None else f":env:.no-index={value!r}\n", list[list[str]]()

    class Recorded(subprocess.Popen[str]):
        def __init__(self, command: list[str], **options: object) -> None:
            commands.append(command)
            super().__init__([sys.executable, "-c", ""], stderr=subprocess.PIPE, text=True)

    monkeypatch.setattr(
        install.subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 0, listing, "")
    )
    monkeypatch.setattr(install.subprocess, "Popen", Recorded)
    assert install.install_with_uv(["-e", "."])
    assert ("--no-index" in commands[0]) == is_passed


@pytest.mark.parametrize("fails", ["uv cannot be installed", "uv fails"])
def test_pip_installs_where_uv_cannot(
    fails: str, install: ModuleType, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    commands: list[list[str]] = []

    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        commands.append(command)
        is_uv = command[-1] == "uv"
        return subprocess.CompletedProcess(command, int(is_uv and fails == "uv cannot be installed"), "", "")

    class Failing(subprocess.Popen[str]):
        def __init__(self, command: list[str], **options: object) -> None:
            assert command[1:5] == ["-m", "uv", "pip", "install"]
            super().__init__(
                [sys.executable, "-c", "import sys; sys.exit('no such index')"], stderr=subprocess.PIPE, text=True
            )

    monkeypatch.setattr(install, "print_largest", lambda: None)
    monkeypatch.setattr(install.subprocess, "run", run)
    monkeypatch.setattr(install.subprocess, "Popen", Failing)
    install.install(["-e", "."])
    assert commands[-1][-2:] == ["-e", "."]
    printed = capfd.readouterr()
    assert "pip installs the packages" in printed.out
    assert ("no such index" in printed.err) == (fails == "uv fails")


def test_the_ten_largest_packages_are_printed(install: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    install.print_largest()
    printed = capsys.readouterr().out
    assert printed.count(",") >= install.LARGEST
    assert "torch" in printed
