"""How long does a newcomer wait for the first result? The bundled example, cold and warm.

    python experiments/first_result.py --out results/first_result

Runs `jaxlines fit example:control-line` twice as a command of its own: with an empty folder for compiled programs, as
after a fresh installation, and again with the programs that the first run left there. Exits with 1 when a run fails or
takes longer than its limit.
"""

import argparse
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMMAND = ("fit", "example:control-line")
LIMITS = {"cold_seconds": 30.0, "warm_seconds": 10.0}


def cpu_name() -> str:
    """The name of the processor as the system gives it, with its family and model, which say more."""
    info = Path("/proc/cpuinfo")
    lines = [line.partition(":") for line in info.read_text().splitlines()] if info.exists() else []
    found = {key.strip(): value.strip() for key, _, value in lines}
    if "model name" not in found:
        return platform.processor() or platform.machine()
    return f"{found['model name']} (family {found.get('cpu family', '?')}, model {found.get('model', '?')})"


def machine() -> dict:
    """What the times were measured on, and how busy it was before."""
    return {
        "cpu": cpu_name(),
        "cpu_count": os.cpu_count(),
        "load_average_before": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        "jax": importlib.metadata.version("jax"),
        "jaxlines": importlib.metadata.version("jaxlines"),
    }


def timed_run(cache: str) -> float:
    """Wall time of one run [s] with a folder for compiled programs. Raises CalledProcessError when it fails."""
    program = Path(sys.executable).with_name("jaxlines")
    began = time.perf_counter()
    environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": cache}
    subprocess.run([str(program), *COMMAND, "--quiet"], env=environment, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began


def finding(result: dict) -> str:
    """The result in one line."""
    m = result["machine"]
    times = ", ".join(
        f"{name.split('_')[0]} {result[name]:.1f} s (limit {limit:g} s)" for name, limit in LIMITS.items()
    )
    load = "" if m["load_average_before"] is None else f", load {m['load_average_before']:.1f} before"
    missed = [name.split("_")[0] for name, limit in LIMITS.items() if result[name] > limit]
    verdict = f"MISSED: {', '.join(missed)}" if missed else "within both limits"
    return f"first result of the example: {times} on {m['cpu']}, {m['cpu_count']} cores{load}; {verdict}"


def main() -> int:
    """Run twice, write `results.json`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json")
    folder = parser.parse_args().out
    result: dict = {"machine": machine()}
    with tempfile.TemporaryDirectory() as cache:
        result |= {name: timed_run(cache) for name in LIMITS}
    result |= {"limits": LIMITS, "ok": all(result[name] <= limit for name, limit in LIMITS.items())}
    result["finding"] = finding(result)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "results.json").write_text(json.dumps(result, indent=1) + "\n")
    print(result["finding"])
    return 0 if result["ok"] else 1


if __name__ == "__main__":
    sys.exit(main())
