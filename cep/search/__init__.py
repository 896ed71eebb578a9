"""Search of shutter codes, and whether to code an exposure at all.

A :class:`~cep.search.problem.SearchProblem` holds the motions, the objective and the limits of a
code. What else is here, in the order in which it is used:

problem
    ``limits`` of a code, and which conflict (``sampling``: random codes within them;
    ``playable``: those of a device), ``objectives`` by name, ``cost`` of codes by them.
search
    ``baselines``, what would be used instead; ``annealing`` or ``exhaustive``, and ``optima``
    proven before; ``code_search`` joins them to a ``search_result``. ``bounds``: what no code can
    exceed.
verdict
    ``exposures``, judged by the restoration ``expected`` of a model and ``measured`` on
    photographs; ``verdict`` at one level of light, in words ``verdict_text``; ``advise`` over the
    light, ``chip_count``.
optimize
    All of it: the code, its comparison, certificate, bound and verdict.
"""
