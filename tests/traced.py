"""Count the operations of a traced program."""

from collections import Counter

import jax


def primitives(function, *arguments):
    """Count each primitive of the program, inner programs included."""

    def count(jaxpr):
        total = Counter(equation.primitive.name for equation in jaxpr.eqns)
        for equation in jaxpr.eqns:
            inner = jax.tree.leaves(
                list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")
            )
            total += sum((count(x) for x in inner if hasattr(x, "eqns")), Counter())
        return total

    return count(jax.make_jaxpr(function)(*arguments).jaxpr)
