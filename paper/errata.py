"""All misprints of the paper, each compared with the correct form."""

from paper.data import PaperData
from paper.errata_least_squares import of_least_squares
from paper.errata_maximum_likelihood import of_maximum_likelihood
from paper.errata_network import of_the_network
from paper.errata_valve import of_the_valve
from paper.erratum import Erratum
from valvemap.model.rbf_network import RbfNetwork


def show(data: PaperData, network: RbfNetwork) -> list[Erratum]:
    """Compute both forms of every misprint, in the order of the equations."""
    return [
        *of_the_valve(data),
        *of_least_squares(data),
        *of_maximum_likelihood(),
        *of_the_network(data, network),
    ]
