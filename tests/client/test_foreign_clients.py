"""Clients that other people's generators make of openapi.json: they upload, poll, receive a webhook and download."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.js_tools import JS_TOOLS, ROOT

PAGE = ROOT / "openapi" / "openapi.json"
FOREIGN = Path(__file__).with_name("foreign")
CSHARP_TOOLS = ROOT / ".cache" / "csharp-tools"
WANTED = {"event": "True", "file": "True", "refused": "404"}


@pytest.mark.slow
def test_a_csharp_client_of_openapi_generator_goes_all_the_way(url, hook_port, tree, tmp_path) -> None:
    if not (CSHARP_TOOLS / ".ready").exists() or shutil.which("java") is None:
        pytest.skip("a C# compiler is not there: make csharp-tools, with java, node and npm")
    (runtime,) = CSHARP_TOOLS.glob("lib/python*/site-packages/dnv/net/runtime/.net")
    names = "targetFramework=net8.0,packageName=DynamicTree,supportsRetry=false"
    generated = tmp_path / "generated"
    generator = [CSHARP_TOOLS / "bin/openapi-generator-cli", "generate", "-i", PAGE, "-g", "csharp", "-o", generated]
    _run(*generator, "--library", "httpclient", f"--additional-properties={names}")
    sources = [FOREIGN / "UseClient.cs", *(generated / "src" / "DynamicTree").rglob("*.cs")]
    program = tmp_path / "UseClient.dll"
    _run(CSHARP_TOOLS / "bin/python", FOREIGN / "compile_csharp.py", CSHARP_TOOLS, program, *sources)
    _check(_run(runtime / "dotnet", program, url, tree, hook_port))


@pytest.mark.slow
def test_a_typescript_client_of_openapi_fetch_goes_all_the_way(url, hook_port, tree, tmp_path) -> None:
    binaries = JS_TOOLS / "node_modules" / ".bin"
    if not (binaries / "openapi-typescript").exists() or shutil.which("node") is None:
        pytest.skip("openapi-typescript is not there: make js-tools, with node and npm")
    (tmp_path / "node_modules").symlink_to(JS_TOOLS / "node_modules")
    for name in ("use_client.ts", "tsconfig.json"):
        shutil.copy(ROOT / "tests" / "js" / name, tmp_path)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    _run(binaries / "openapi-typescript", PAGE, "--default-non-nullable", "false", "-o", tmp_path / "openapi.d.ts")
    _run(binaries / "tsc", "-p", tmp_path, "--noEmit", "false")
    _check(_run("node", tmp_path / "use_client.js", url, tree, hook_port))


def _check(printed: str) -> None:
    """What each program prints: the event is signed and of its job, the file whole, a refusal is reported as one."""
    lines = [line.split() for line in printed.splitlines()]
    assert {line[0]: line[-1].replace("true", "True") for line in lines} == WANTED


def _run(*command: object) -> str:
    environment = os.environ | {"DOTNET_SYSTEM_GLOBALIZATION_INVARIANT": "1"}  # runs without ICU
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout
