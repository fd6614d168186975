"""The contract of `make check` that no module imports itself by way of others: import-linter has none for modules."""

from collections.abc import Iterable, Mapping
from graphlib import CycleError, TopologicalSorter

from grimp import ImportGraph
from importlinter import Contract, ContractCheck, fields, output


class NoCircle(Contract):
    """No module under `package` imports itself by way of others, imports within functions and for types counted."""

    package = fields.StringField()

    def check(self, graph: ImportGraph, verbose: bool) -> ContractCheck:
        """Look for a circle; the first one found is told."""
        modules = {str(self.package), *graph.find_descendants(str(self.package))}
        imports = {name: graph.find_modules_directly_imported_by(name) & modules for name in modules}
        circle = find_circle(imports)
        return ContractCheck(kept=not circle, metadata={"circle": circle})

    def render_broken_contract(self, check: ContractCheck) -> None:
        """Print the circle."""
        for importer, imported in zip(check.metadata["circle"], check.metadata["circle"][1:], strict=False):
            output.print_error(f"{importer} imports {imported}", bold=False)


def find_circle(imports: Mapping[str, Iterable[str]]) -> list[str]:
    """Modules of which each imports the next one, the last being the first again; empty where there is no circle."""
    try:
        TopologicalSorter({name: sorted(imports[name]) for name in sorted(imports)}).prepare()
    except CycleError as error:
        return list(reversed(error.args[1]))
    return []
