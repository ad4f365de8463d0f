"""Make certificates and keys for the link of a deployed team: for tests, on the spot.

    python tools/make_link_keys.py keys --robots 8
    robosim deploy world paper-8 --keys keys        # and so on, all processes with --keys

Writes an authority, and a certificate and a key for the world, the pheromone service, the operator (who may
stop and release the team) and each robot, with which each process proves who it is; `openssl` must be
installed. The authority's own key is not kept. On real robots every machine gets only ca.pem and its own two
files. Keys never belong into a repository.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from robosim.deploy.link.access import AUTHORITY, OPERATOR, PHEROMONES, WORLD, robot_name

CURVE = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")


def openssl(*arguments: str) -> None:
    done = subprocess.run(["openssl", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"openssl {arguments[0]} failed: {done.stderr.strip()}")


def make_keys(folder: Path, robots: int, days: int = 30, hosts: tuple[str, ...] = ("127.0.0.1",)) -> None:
    """Fill `folder`, which must be new or empty; certificates name the `hosts` (IP addresses) of all."""
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise RuntimeError(f"{folder}: not empty")
    folder.chmod(0o700)
    authority = folder / AUTHORITY
    with tempfile.TemporaryDirectory() as scratch:
        secret, request, extensions = (Path(scratch) / name for name in ("ca.key", "request", "extensions"))
        names = ",".join(["DNS:localhost", *(f"IP:{host}" for host in hosts)])
        extensions.write_text(f"subjectAltName={names}\nextendedKeyUsage=serverAuth,clientAuth\n")
        subject = ("-subj", "/CN=robosim test authority")
        openssl(
            "req",
            "-x509",
            *CURVE,
            "-keyout",
            str(secret),
            "-out",
            str(authority),
            *subject,
            "-days",
            str(days),
        )
        for name in (WORLD, PHEROMONES, OPERATOR, *map(robot_name, range(robots))):
            key, certificate = folder / f"{name}.key", folder / f"{name}.pem"
            openssl("req", *CURVE, "-keyout", str(key), "-out", str(request), "-subj", f"/CN={name}")
            key.chmod(0o600)
            serial = ("-CAcreateserial", "-CAserial", str(Path(scratch) / "serial"))
            signed_by = ("-CA", str(authority), "-CAkey", str(secret), *serial)
            openssl(
                *("x509", "-req", "-in", str(request), *signed_by, "-out", str(certificate)),
                *("-days", str(days), "-extfile", str(extensions)),
            )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="a new or empty folder")
    parser.add_argument("--robots", type=int, default=8)
    parser.add_argument("--days", type=int, default=30, help="how long the certificates hold")
    parser.add_argument("--hosts", nargs="*", default=["127.0.0.1"], help="IP addresses of the machines")
    options = parser.parse_args()
    try:
        make_keys(options.folder, options.robots, options.days, tuple(options.hosts))
    except (OSError, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{options.folder}: certificates and keys for {options.robots} robots, the world and the map")
    return 0


if __name__ == "__main__":
    sys.exit(main())
