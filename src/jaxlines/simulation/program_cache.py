"""Compiled programs kept on disk, so that a second process does not compile them again."""

import tempfile
from pathlib import Path


def default_cache_folder() -> str | None:
    """The user's folder for compiled programs, made if needed; None when it cannot be written."""
    import platformdirs

    folder = Path(platformdirs.user_cache_dir("jaxlines")) / "jax"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return None
    return str(folder)


def cache_programs(folder: str | Path | None = None) -> str:
    """Keep compiled programs in a folder and take them from there; a setting of JAX for the whole process.

    The command line does so by itself. Programs of the adaptive engine can be kept only when the environment
    variable EQX_ON_ERROR is "nan" before JAX is imported.

    Args: folder: made if needed; by default one among the user's caches. Returns: the folder.
    Raises: OSError when the folder cannot be written.
    """
    import jax

    chosen = default_cache_folder() if folder is None else str(folder)
    if chosen is None:
        raise OSError("no folder for compiled programs can be written: give one")
    Path(chosen).mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", chosen)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return chosen
