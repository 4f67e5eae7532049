"""Runtime checks of protocols that ask each class once."""

from typing import Protocol, runtime_checkable

from valvemap.model.capabilities import Forgetful, PathDependent
from valvemap.model.protocol_checks import CheckedByClass
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares


@runtime_checkable
class Bending(Protocol, metaclass=CheckedByClass):
    def bend(self) -> float: ...


class Pipe:
    def bend(self) -> float:
        return 90.0


class Elbow(Pipe):
    pass


class Straight(Pipe):
    bend = None


def test_classes_implement_a_protocol_as_typing_says():
    assert isinstance(Pipe(), Bending)
    assert isinstance(Elbow(), Bending)
    assert not isinstance(Straight(), Bending)
    assert not isinstance(1.0, Bending)


def test_the_answer_is_the_same_again_and_of_its_class_alone():
    assert [isinstance(one, Bending) for one in (Pipe(), 1.0, Pipe(), 1.0)] == [True, False] * 2


def test_a_class_has_one_capability_and_not_another():
    estimator = RecursiveLeastSquares()
    assert isinstance(estimator, Forgetful)
    assert not isinstance(estimator, PathDependent)
    assert isinstance(RbfNetwork(), Forgetful) == hasattr(RbfNetwork(), "with_forgetting")
