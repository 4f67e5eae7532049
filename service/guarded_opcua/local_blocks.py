"""The inside of a server: values in blocks, as their owner handles them."""

from collections.abc import Sequence

import numpy as np
from asyncua import ua
from numpy.typing import ArrayLike, NDArray

from guarded_opcua.address_space.blocks import Block
from guarded_opcua.address_space.declarations import Variable
from guarded_opcua.errors import ServerError
from guarded_opcua.local_nodes import LocalNodes


class LocalBlocks(LocalNodes):
    """Nodes whose values are written one by one or, as arrays, in blocks."""

    def add_block(self, variables: Sequence[Variable], length: int | None = None) -> Block:
        """Store variables of one type as arrays, to be written by :meth:`write_block`.

        Parameters
        ----------
        variables
            Variables that change together; each belongs to at most one block.
        length
            Length of the variables' values if they are arrays.

        Raises
        ------
        ServerError
            if the variables differ in type or are not numeric.
        """
        if not variables:
            raise ServerError("a block needs variables")
        block = self.add_empty_block(variables[0].type, length, len(variables))
        for variable in variables:
            block.check(variable)
        for column, variable in enumerate(variables):
            block.adopt(column, self._value(variable).value)
            self.show(variable, block, column)
        return block

    def add_empty_block(self, type_: ua.VariantType, length: int | None, n: int) -> Block:
        """Store n values of one type as arrays; variables are attached later by :meth:`show`.

        Until the first write their status is BadWaitingForInitialData.
        """
        ledger = self._subscriptions.ledger
        return Block(type_, n, length, ledger, self._clock.now())

    def show(self, variable: Variable, block: Block, column: int) -> None:
        """Attach a variable to one column of a block.

        Raises
        ------
        ServerError
            if the variable's type differs from the block's.
        """
        block.show(column, variable, self._value(variable))
        self._subscriptions.items.blocks[variable.id] = block, column

    def show_also(self, variable: Variable, of: Variable) -> None:
        """Give a variable the value of another one of its type, present and future."""
        aspace = self._inside.aspace
        value = ua.AttributeIds.Value
        aspace[variable.id].attributes[value] = aspace[of.id].attributes[value]
        place = self._subscriptions.items.blocks.get(of.id)
        if place is not None:
            self._subscriptions.items.blocks[variable.id] = place

    def write_block(
        self,
        block: Block,
        values: ArrayLike,
        source_times: ArrayLike,
        codes: ArrayLike = ua.StatusCodes.Good,
        present: ArrayLike | None = None,
        columns: ArrayLike | None = None,
    ) -> None:
        """Publish k successive samples of a block; equivalent to k calls of :meth:`write`.

        Parameters
        ----------
        block
            n variables.
        values
            Shape (k, n); (k, n, length) if the variables are arrays.
        source_times
            UTC ns, shape (k,) or (k, n).
        codes
            StatusCodes, one for all or of shape (k, n). A Bad one drops the value.
        present
            Shape (k, n), False where there is no sample; None: all True.
        columns
            The n columns that are written, each once, in any order; None: all columns.
        """
        block.take(block.batch(values, source_times, codes, present, self._clock.now(), columns))

    def mark_block(self, block: Block, code: int, columns: NDArray[np.intp] | None = None) -> None:
        """Change the status of a block's values, in the given columns or all; keep the rest."""
        block.take(block.marked(code, self._clock.now(), columns))
