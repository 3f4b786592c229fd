"""An interpreter with the vendor's official SDK, which needs an older NumPy than the product.

The package `py-livox2` bundles the compiled SDK. It lives in an environment of its own beside the
product's, made on first use: ``python -m tests.sitl.livox_sdk_environment``.
"""

import subprocess
import sys
from pathlib import Path

ENVIRONMENT = Path(__file__).resolve().parents[2] / ".venv-livox-sdk"
REQUIREMENTS = ("py-livox2==0.1.0", "numpy<2.3")
INSTALL_TIMEOUT_S = 120.0


class SdkUnavailableError(Exception):
    """The SDK cannot be installed here; the text says why."""


def sdk_interpreter() -> Path:
    """Return an interpreter that can import `livox_sdk`, installing it if need be.

    Raises:
        SdkUnavailableError: if it cannot be installed, for example without network.
    """
    interpreter = ENVIRONMENT / "bin" / "python"
    if _imports_sdk(interpreter):
        return interpreter
    _run(sys.executable, "-m", "venv", "--clear", str(ENVIRONMENT))
    _run(str(interpreter), "-m", "pip", "install", "--quiet", "--retries", "1", *REQUIREMENTS)
    if not _imports_sdk(interpreter):
        raise SdkUnavailableError("py-livox2 was installed but cannot be imported")
    return interpreter


def _imports_sdk(interpreter: Path) -> bool:
    if not interpreter.exists():
        return False
    command = [str(interpreter), "-c", "import livox_sdk"]
    return (
        subprocess.run(command, capture_output=True, timeout=INSTALL_TIMEOUT_S, check=False).returncode == 0
    )


def _run(*command: str) -> None:
    try:
        subprocess.run(command, capture_output=True, timeout=INSTALL_TIMEOUT_S, check=True)
    except subprocess.CalledProcessError as error:
        last = error.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise SdkUnavailableError(f"{' '.join(command[:4])} failed: {' '.join(last)}") from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise SdkUnavailableError(f"{' '.join(command[:4])} failed: {error}") from None


if __name__ == "__main__":
    sys.stdout.write(f"{sdk_interpreter()}\n")
