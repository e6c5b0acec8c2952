"""Compile C# by Roslyn on .NET 8: `compile_csharp.py TOOLS OUT.dll SOURCES…`, in what `make csharp-tools` installs."""

import shutil
import sys
from pathlib import Path
from typing import Any


def main(tools: Path, out: Path, sources: list[Path]) -> int:
    from clr_loader import get_coreclr
    from pythonnet import set_runtime

    (runtime,) = tools.glob("lib/python*/site-packages/dnv/net/runtime")
    set_runtime(get_coreclr(runtime_config=str(runtime / "runtimeconfig.json"), dotnet_root=str(runtime / ".net")))
    import clr

    sys.path.append(str(tools / "node_modules/@autorest/csharp"))
    clr.AddReference("Microsoft.CodeAnalysis.CSharp")
    import Microsoft.CodeAnalysis as Roslyn
    from Microsoft.CodeAnalysis import CSharp
    from System.Collections.Generic import List
    from System.IO import File

    trees: Any = List[Roslyn.SyntaxTree]()
    for source in sources:
        trees.Add(CSharp.CSharpSyntaxTree.ParseText(source.read_text(), path=str(source)))
    json_library = tools / "node_modules/nswag/bin/binaries/Net80/Newtonsoft.Json.dll"
    references: Any = List[Roslyn.MetadataReference]()
    framework = [path for path in runtime.glob(".net/shared/*/*/*.dll") if path.name.startswith(("System.", "netst"))]
    for path in [*framework, json_library]:
        references.Add(Roslyn.MetadataReference.CreateFromFile(str(path)))
    options = CSharp.CSharpCompilationOptions(Roslyn.OutputKind.ConsoleApplication)
    stream = File.Create(str(out))
    result = CSharp.CSharpCompilation.Create(out.stem, trees, references, options).Emit(stream)
    stream.Close()
    errors = [entry for entry in result.Diagnostics if entry.Severity == Roslyn.DiagnosticSeverity.Error]
    sys.stdout.writelines(f"{error}\n" for error in errors)
    shutil.copy(json_library, out.parent)
    out.with_suffix(".runtimeconfig.json").write_text((runtime / "runtimeconfig.json").read_text())
    return 0 if result.Success else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), [Path(each) for each in sys.argv[3:]]))
