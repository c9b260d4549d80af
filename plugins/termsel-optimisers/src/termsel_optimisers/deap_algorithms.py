"""DEAP's algorithms, or loops of a user's own, as solvers."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from typing import Any

import numpy as np
from deap import algorithms, base, tools
from numpy.typing import NDArray

from termsel import Evaluation, Generation, Option, Problem, Solver, TermselError
from termsel.toolkit import attribute_errors_to, modules_here
from termsel.toolkit.searches import SEGMENTS, OwnChance
from termsel_optimisers.deap_toolbox import Individual, register, to_deap

DEAP_ALGORITHMS = ("eaSimple", "eaMuPlusLambda", "eaMuCommaLambda")
"""Names of the algorithms of deap.algorithms."""

CHECK = "Check your loop, and the operators with their arguments: select, mate, mutate."

POPULATION = Option("population", 200, "Number of individuals, mu.", int, 2, 100_000)


class Deap(Solver):
    """An algorithm of DEAP with operators of `deap.tools`, one individual at a time.

    eaSimple, eaMuPlusLambda or eaMuCommaLambda of `deap.algorithms` as they are, generation by
    generation; or a loop of your own, ``module:function``. Operators are named with their
    arguments: ``--set select=selTournament:tournsize=3``. Individuals have a `deap.base.Fitness`;
    those that are infeasible have one penalised by `deap.tools.DeltaPenalty`. DEAP draws from
    Python's global random state, which is left as it was. The solver ``ga`` is the same search
    with operators on the whole population, without DEAP's lists: faster, and equally good.

    ``Generation.details`` holds a DEAP ``logbook`` of what `deap.tools.Statistics` compiles, and
    the ``halloffame``.
    """

    name = "deap"
    segments = SEGMENTS
    declared_options = (
        Option("algorithm", "eaSimple", "eaSimple, eaMuPlusLambda or eaMuCommaLambda of "
               "deap.algorithms, or a loop of your own as module:function.",
               from_files=DEAP_ALGORITHMS),
        POPULATION,
        Option("children", None, "Children of a generation, lambda, of eaMuPlusLambda and "
               "eaMuCommaLambda; by default twice the population.", int, 2, 200_000),
        Option("select", "selTournament:tournsize=3", "Selection of deap.tools, with its "
               "arguments."),
        Option("mate", None, "Crossover of deap.tools, with its arguments; by default "
               "cxUniform:indpb=0.5, or operators for genes that are not bits."),
        Option("mutate", None, "Mutation of deap.tools, with its arguments; by default mutFlipBit "
               "with one flip on average, or operators for genes that are not bits."),
        Option("cxpb", None, "Chance that a pair mates; by default 0.9, and 0.7 with "
               "eaMuPlusLambda and eaMuCommaLambda.", float, 0.0, 1.0),
        Option("mutpb", None, "Chance that an individual mutates; by default 1, and 0.3 with "
               "eaMuPlusLambda and eaMuCommaLambda.", float, 0.0, 1.0),
    )

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield the generations of DEAP's algorithm without end (see `Solver.generations`).

        Raises TermselError for chances, or a number of children, that the algorithm cannot have.
        """
        o = self.options
        box = to_deap(problem)
        for role in ("select", "mate", "mutate"):
            register(box, role, o[role], problem.genome)
        loop = _algorithm_of_name(o["algorithm"])
        # eaSimple may both cross and mutate a child, the others do one of both, or neither.
        chances = {"cxpb": 0.7, "mutpb": 0.3}
        if o["algorithm"] == "eaSimple":
            chances = {"cxpb": 0.9, "mutpb": 1.0}
        chances.update({name: o[name] for name in chances if o[name] is not None})
        # For those the chances add up.
        if "lambda_" in inspect.signature(loop).parameters and sum(chances.values()) > 1:
            raise TermselError(f"cxpb and mutpb of {o['algorithm']} add up to "
                               f"{sum(chances.values()):g}", hint="They may add up to 1 at most.")
        if not sum(chances.values()):
            raise TermselError("cxpb and mutpb are 0, so no individual would ever change",
                               hint="Raise one of them.")
        mu = o["population"]
        children = o["children"] or 2 * o["population"]
        if o["algorithm"] == "eaMuCommaLambda" and children < mu:
            raise TermselError(f"eaMuCommaLambda keeps {mu} of {children} children",
                               hint="Raise children or lower the population.")
        yield from generations_of(box, loop, rng, mu, {**chances, "mu": mu, "lambda_": children})


def _algorithm_of_name(loop_name: str) -> Callable[..., Any]:
    """Return DEAP's algorithm of a name, or the function that module:function names.

    Raises TermselError if there is no such algorithm or function, or it cannot be called.
    """
    module, _, name = loop_name.rpartition(":")
    if not module:
        if name in DEAP_ALGORITHMS:
            loop: Callable[..., Any] = getattr(algorithms, name)
            return loop
        raise TermselError(f"there is no algorithm {loop_name!r}",
                           hint=f"Known are {', '.join(DEAP_ALGORITHMS)}; a loop of yours is "
                                "module:function.")
    # Only what can be called has a signature.
    try:
        with modules_here():
            loop = getattr(import_module(module), name)
        inspect.signature(loop)
    except (ImportError, AttributeError, NameError, SyntaxError, TypeError, ValueError) as error:
        raise TermselError(f"the loop {loop_name!r} cannot be imported: {error}",
                           hint="Give module:function, importable from where you run.") from None
    return loop


def generations_of(box: base.Toolbox, loop: Callable[..., Any], rng: np.random.Generator,
                   population: int, arguments: Mapping[str, Any]) -> Iterator[Generation]:
    """Yield the generations of a DEAP algorithm, or of a loop of the same kind.

    `box` is a toolbox as of `to_deap`. The loop is called with population and toolbox, and with
    those of `arguments`, ``stats``, ``halloffame`` and ``verbose`` that it has as parameters. A
    loop with ``ngen`` is called for one generation at a time, and at first for none; any other must
    be a generator function, which yields the population after each generation. Raises TermselError
    for other loops, and for one that returns no population.
    """
    parameters = inspect.signature(loop).parameters
    stats = tools.Statistics(lambda individual: individual.fitness.values[0])
    for statistic in ("min", "median", "max"):
        stats.register(statistic, getattr(np, statistic))
    hall_of_fame = tools.HallOfFame(1)
    logbook = tools.Logbook()
    offered = {**arguments, "stats": stats, "halloffame": hall_of_fame, "verbose": False}
    accepted = {key: value for key, value in offered.items() if key in parameters}
    loop_name = getattr(loop, "__name__", "loop")
    if "ngen" not in parameters and not inspect.isgeneratorfunction(loop):
        raise TermselError(f"the loop {loop_name!r} has no argument 'ngen' and yields nothing",
                           hint="Let it run ngen generations as eaSimple does, or yield the "
                                "population after each.")
    # DEAP draws from Python's global random state, which `chance` replaces by one of its own.
    chance = OwnChance(rng)
    with chance:
        individuals = box.population(n=population)
    steps = loop(individuals, box, **accepted) if "ngen" not in parameters else None
    for index in itertools.count():
        with attribute_errors_to(loop, loop_name, CHECK), chance:
            if steps is not None:
                individuals = next(steps, None)
            else:
                # With ngen 0 the loop only evaluates the first population.
                individuals, _log = loop(individuals, box, ngen=min(index, 1), **accepted)
            if individuals is None and steps is not None:
                return
            if not individuals:
                raise TermselError(f"the loop {loop_name!r} returned no population", hint=CHECK)
            _evaluate(box, individuals)
        hall_of_fame.update(individuals)
        logbook.record(gen=index, **stats.compile(individuals))
        yield _as_generation(index, individuals, {"logbook": logbook, "halloffame": hall_of_fame})


def _evaluate(box: base.Toolbox, individuals: Iterable[Individual]) -> None:
    """Evaluate the individuals that a loop has left without a fitness."""
    unevaluated = [individual for individual in individuals if not individual.fitness.valid]
    for individual, values in zip(unevaluated, box.map(box.evaluate, unevaluated), strict=True):
        individual.fitness.values = values


def _as_generation(index: int, individuals: list[Individual],
                   details: Mapping[str, Any]) -> Generation:
    """Return individuals with their objectives and violations as a generation of this number."""
    genes: NDArray[Any] = np.array(individuals)
    return Generation(index, genes, Evaluation(
        np.array([individual.objectives for individual in individuals]),
        np.array([individual.violation for individual in individuals])), details)


def from_deap(toolbox_factory: Callable[[Problem], base.Toolbox],
              algorithm: Callable[..., Any] = algorithms.eaSimple, *, name: str | None = None,
              **arguments: Any) -> type[Solver]:
    """Return a solver made of a DEAP toolbox and an algorithm.

    Parameters
    ----------
    toolbox_factory : callable
        Takes a problem and returns a toolbox, such as `to_deap`, or a function that replaces
        operators of what `to_deap` returns.
    algorithm : callable
        Of `deap.algorithms`, or a loop of one's own, which takes ``ngen`` or yields the
        population after each generation.
    name : str, optional
        Name of the solver; by default that of the factory.
    **arguments
        Of the algorithm, such as cxpb and mutpb; 0.5 and 0.2 by default.

    Returns
    -------
    type[Solver]
        With the option ``population``.

    Raises
    ------
    TermselError
        For what is no function; in the search for one that returns no toolbox or population.

    Examples
    --------
    >>> import termsel, termsel_optimisers
    >>> made = termsel_optimisers.from_deap(termsel_optimisers.to_deap)
    >>> result = termsel.run("poly-terms", solver=made,
    ...                      evaluations=300, options={"degree": 2, "population": 40})
    >>> result.solver
    'to-deap'
    """
    for given_as, argument in (("toolbox_factory", toolbox_factory), ("algorithm", algorithm)):
        if not callable(argument):
            raise TermselError(f"{given_as} is {argument!r:.100}, which is no function",
                               hint="Give a function, such as termsel_optimisers.to_deap and "
                                    "deap.algorithms.eaSimple.")
    loop_arguments = {"cxpb": 0.5, "mutpb": 0.2, **arguments}
    factory_name = getattr(toolbox_factory, "__name__", "from-deap")
    doc = inspect.getdoc(toolbox_factory) or "A DEAP toolbox of a user's own."

    class FromDeap(Solver):
        __doc__ = doc.splitlines()[0]
        segments = SEGMENTS
        declared_options = (POPULATION,)

        def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
            """Yield the generations of the loop; TermselError if the factory gives no toolbox."""
            n = self.options["population"]
            box = toolbox_factory(problem)
            if not isinstance(box, base.Toolbox):
                raise TermselError(f"the function {factory_name!r} returned no DEAP toolbox",
                                   hint="Return what termsel_optimisers.to_deap(problem) returned.")
            # Twice as many children as parents, unless the user says otherwise.
            yield from generations_of(box, algorithm, rng, n,
                                      {"mu": n, "lambda_": 2 * n, **loop_arguments})

    FromDeap.name = name or factory_name.strip("_").replace("_", "-").lower()
    return FromDeap
