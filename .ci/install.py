"""Install packages into the environment of the Python that runs this, with uv where possible, else with pip.

    .venv/bin/python .ci/install.py -e ".[dev]"      # arguments as for `pip install`

pip installs uv into the same environment. uv does not read the settings of pip, so they are passed on: packages come
from where pip takes them on this machine, with the same versions.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from importlib.metadata import Distribution, distributions
from pathlib import Path
from urllib.parse import unquote, urlsplit

PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check")
PIP_TRUE = ("1", "true", "yes", "on", "t", "y")
"""Values of a setting of pip that switch it on."""
LARGEST = 10
"""Number of packages whose sizes are printed."""
PHASES = {"Resolved": "choosing versions", "Prepared": "downloading", "Installed": "installing"}
"""What uv has done when it prints a line that begins with this word."""


def read_pip_settings(listing: str) -> dict[str, str]:
    """Read what `pip config list` prints; the environment overrides [install], which overrides [global], as in pip."""
    sections: dict[str, dict[str, str]] = {"global": {}, "install": {}, ":env:": {}}
    for line in listing.splitlines():
        key, _, value = line.partition("=")
        section, _, name = key.rpartition(".")
        if section in sections:
            sections[section][name] = ast.literal_eval(value)
    return sections["global"] | sections["install"] | sections[":env:"]


def translate_settings(settings: Mapping[str, str]) -> dict[str, str]:
    """Translate settings of pip into environment variables of uv.

    Places on this machine that do not exist are left out: pip ignores them, uv ends.

    Args:
        settings: Settings of pip by name.

    Returns:
        Variables by name, without those that pip has no setting for.
    """
    places = {
        name: [place for place in settings.get(name, "").split() if _is_there(place)]
        for name in ("find-links", "index-url", "extra-index-url", "constraint", "cert")
    }
    variables = {
        "UV_FIND_LINKS": ",".join(places["find-links"]),
        "UV_DEFAULT_INDEX": " ".join(places["index-url"]),
        "UV_INDEX": " ".join(places["extra-index-url"]),
        "UV_CONSTRAINT": " ".join(places["constraint"]),
        "SSL_CERT_FILE": " ".join(places["cert"]),
        "UV_INSECURE_HOST": " ".join(settings.get("trusted-host", "").split()),
        "UV_HTTP_TIMEOUT": settings.get("timeout", settings.get("default-timeout", "")),
        "ALL_PROXY": settings.get("proxy", ""),
        "UV_INDEX_STRATEGY": "unsafe-best-match",  # as pip: the best version of all indexes, not the first index
    }
    return {name: value for name, value in variables.items() if value}


def _is_there(place: str) -> bool:
    """Return whether a path or a file URL exists; other URLs count as existing."""
    parts = urlsplit(place)
    if parts.scheme == "file":
        return Path(unquote(parts.path)).exists()
    return "://" in place or Path(place).expanduser().exists()


def install_with_uv(arguments: list[str]) -> bool:
    """Install with uv, print what it spent, and return whether it succeeded."""
    began = time.monotonic()
    if subprocess.run([*PIP, "install", "--quiet", "uv"], check=False, stderr=subprocess.DEVNULL).returncode:
        print("uv could not be installed; pip installs the packages, which takes longer.", flush=True)
        return False
    listing = subprocess.run([*PIP, "config", "list"], check=True, capture_output=True, text=True).stdout
    settings = read_pip_settings(listing)
    environment = translate_settings(settings) | os.environ  # variables of uv itself come first
    options = ["--no-index"] if settings.get("no-index", "").lower() in PIP_TRUE else []
    command = [sys.executable, "-m", "uv", "pip", "install", *options, "--python", sys.executable, *arguments]
    last, spent, lines = time.monotonic(), {"getting uv": time.monotonic() - began}, list[str]()
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            lines.append(line)
            if (phase := PHASES.get(line.partition(" ")[0])) is not None:
                now = time.monotonic()
                spent[phase], last = now - last, now
    if process.returncode:
        print("".join(lines), end="", file=sys.stderr)
        print("uv failed; pip installs the packages, which takes longer.", flush=True)
        return False
    if "installing" in spent:
        parts = ", ".join(f"{phase} {seconds:.0f} s" for phase, seconds in spent.items())
        print(f"Packages took {sum(spent.values()):.0f} s: {parts}.")
    return True


def install_with_pip(arguments: list[str]) -> None:
    """Install with pip."""
    began = time.monotonic()
    subprocess.run([*PIP, "install", "--quiet", *arguments], check=True)
    print(f"Packages took {time.monotonic() - began:.0f} s: pip downloaded and installed them.")


def print_largest() -> None:
    """Print the largest installed packages."""
    sizes = sorted(((_measure_size(one), one.metadata["Name"]) for one in distributions()), reverse=True)
    names = ", ".join(f"{name} {size / 1e6:.0f}" for size, name in sizes[:LARGEST])
    print(f"{len(sizes)} packages, {sum(size for size, _ in sizes) / 1e6:.0f} MB. The largest (MB): {names}.")


def _measure_size(package: Distribution) -> int:
    return sum(file.size or 0 for file in package.files or ())


def install(arguments: list[str]) -> None:
    """Install with uv; if that fails, with pip."""
    if not install_with_uv(arguments):
        install_with_pip(arguments)
    print_largest()


if __name__ == "__main__":
    try:
        install(sys.argv[1:])
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)
