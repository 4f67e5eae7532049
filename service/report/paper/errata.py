"""All misprints of the paper, each shown failing beside the right form."""

from service.identification.rbf_network import RbfNetwork
from service.report.paper.data import PaperData
from service.report.paper.errata_least_squares import of_least_squares
from service.report.paper.errata_maximum_likelihood import of_maximum_likelihood
from service.report.paper.errata_network import of_the_network
from service.report.paper.errata_valve import of_the_valve
from service.report.paper.erratum import Erratum


def show(data: PaperData, network: RbfNetwork) -> list[Erratum]:
    """Compute both forms of every misprint, in the order of the equations."""
    return [
        *of_the_valve(data),
        *of_least_squares(data),
        *of_maximum_likelihood(),
        *of_the_network(data, network),
    ]
