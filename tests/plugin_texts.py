"""Sources of plugins that tests install: sound, broken and endless ones."""


MODEL = """
    import numpy as np
    from termsel import Blocks, RationalModel, hookimpl

    class DLT(RationalModel):
        '''Direct linear transformation: one shared denominator, 11 terms.'''
        name = {name!r}
        def blocks(self, ground):
            one = np.column_stack([np.ones(len(ground)), ground])
            return Blocks(line=one, sample=one, shared_denominator=ground)

    @hookimpl
    def termsel_models():
        return [DLT]
"""

BROKEN = {
    "missing import": ("import no_such_module", "No module named 'no_such_module'"),
    "syntax error": ("def x(:", "SyntaxError"),
    "leaves the program": ("import sys; sys.exit(3)", "SystemExit"),
    "no hooks": ("def termsel_models(): return []", "no hooks"),
    "wrong argument": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models(scene): return []""", "scene"),
    "unknown hook": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_modells(): return []""", "Did you mean 'termsel_models'?"),
    "raises": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models(): return 1 / 0""", "termsel_models: ZeroDivisionError"),
    "raises on the way": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models():
            raise ValueError("late")
            yield""", "termsel_models: ValueError: late"),
    "returns nothing": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models(): pass""", "returned None, not a list"),
    "returns text": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_solvers(): return 'ga'""", "returned 'ga', not a list"),
    "returns a class itself": ("""
        from termsel import SensorModel, hookimpl
        @hookimpl
        def termsel_models(): return SensorModel""", "not a list"),
    "of another kind": ("""
        from termsel import Solver, hookimpl
        class Mine(Solver):
            name = 'mine'
            def generations(self, problem, rng): yield
        @hookimpl
        def termsel_models(): return [Mine]""", "the class Mine, not a subclass of SensorModel"),
    "attribute of another type": ("""
        from termsel import Affine, hookimpl
        class Mine(Affine):
            name = 'mine'
            uses_height = 'no'
        @hookimpl
        def termsel_models(): return [Mine]""", "Mine with uses_height = 'no', which is no bool"),
    "options that are none": ("""
        from termsel import Affine, hookimpl
        class Mine(Affine):
            name = 'mine'
            declared_options = ({'name': 'degree'},)
        @hookimpl
        def termsel_models(): return [Mine]""",
        "Mine with declared_options that hold {'name': 'degree'}, which is no Option"),
    "default out of its range": ("""
        from termsel import Affine, Option, hookimpl
        class Mine(Affine):
            name = 'mine'
            declared_options = (Option('powers', 9, 'Powers.', int, 1, 5),)
        @hookimpl
        def termsel_models(): return [Mine]""",
        ", whose option 'powers' has the default 9 and accepts: whole number from 1 to 5"),
    "default that is no choice": ("""
        from termsel import Affine, Option, hookimpl
        class Mine(Affine):
            name = 'mine'
            declared_options = (Option('way', 'up', 'Way.', choices=('left', 'right')),)
        @hookimpl
        def termsel_models(): return [Mine]""",
        "whose option 'way' has the default 'up' and accepts: left | right"),
    "default of a problem": ("""
        from dataclasses import replace
        from termsel import Option, hookimpl
        from termsel.plugins.registry import built_in
        @hookimpl
        def termsel_problems():
            recipe = built_in().get('problems', 'poly-terms')
            option = Option('share', 2.0, 'Share.', float, 0.0, 1.0)
            return [replace(recipe, name='mine', options=(option,))]""",
        "mine, whose option 'share' has the default 2.0 and accepts: number from 0 to 1"),
    "option of no type": ("""
        from termsel import Affine, Option, hookimpl
        class Mine(Affine):
            declared_options = (Option('degree', 2, 'Degree.', list),)""",
        "option 'degree' has the type <class 'list'>"),
    "instance for a class": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models(): return [42]""", "of type int, not a subclass of SensorModel"),
    "instance of another kind": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_problems(): return [{'name': 'x'}]""", "type dict, not an instance of Recipe"),
    "class for an instance": ("""
        from termsel import Recipe, hookimpl
        @hookimpl
        def termsel_problems(): return [Recipe]""", "class Recipe, not an instance of Recipe"),
    "class that needs arguments": ("""
        from termsel import Reader, hookimpl
        class Table(Reader):
            name, summary = 'table', 'points'
            def __init__(self, mark): super().__init__()
            def sniff(self, path, head): return False
            def read(self, path): raise AssertionError
        @hookimpl
        def termsel_readers(): return [Table]""", "argument: 'mark'"),
    "methods missing": ("""
        from termsel import RationalModel, hookimpl
        class Half(RationalModel):
            name = 'half'
        @hookimpl
        def termsel_models(): return [Half]""", "the class Half, which lacks blocks"),
    "no name": ("""
        from termsel import Blocks, RationalModel, hookimpl
        class Nameless(RationalModel):
            def blocks(self, ground): return Blocks(ground, ground)
        @hookimpl
        def termsel_models(): return [Nameless]""", "Nameless with the name None"),
    "impossible name": ("""
        from termsel import Blocks, RationalModel, hookimpl
        class Odd(RationalModel):
            name = 'a b'
            def blocks(self, ground): return Blocks(ground, ground)
        @hookimpl
        def termsel_models(): return [Odd]""", "the name 'a b'"),
    "leaves by an exception of its own": ("""
        class Away(BaseException): pass
        raise Away('far')""", "cannot be imported: Away: far"),
    "leaves by an exception without a message": ("""
        class Away(BaseException):
            def __str__(self): raise ValueError
        raise Away""", "cannot be imported: Away: <exception str() failed>"),
    "leaves as if interrupted": ("raise KeyboardInterrupt", "imported: KeyboardInterrupt"),
    "leaves as if closed": ("raise GeneratorExit", "cannot be imported: GeneratorExit"),
    "hook that leaves as if interrupted": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_models(): raise KeyboardInterrupt""", "termsel_models: KeyboardInterrupt"),
    "hook that leaves": ("""
        from termsel import hookimpl
        class Away(BaseException): pass
        @hookimpl
        def termsel_models(): raise Away('far')""", "termsel_models: Away: far"),
    "command raises": ("""
        from termsel import hookimpl
        @hookimpl
        def termsel_commands(cli): cli.add_command('view')""", "termsel_commands: AttributeError"),
}

INSTANCE = """
    from termsel import Criterion, hookimpl

    class Quantile(Criterion):
        '''A quantile of the check errors [px].'''
        name = 'quantile'
        def score(self, fits): return abs(fits.check_errors).max(axis=(1, 2))

    @hookimpl
    def termsel_criteria(): return [Quantile()]
    """

NEW_RULE = {
    "models": MODEL.format(name="new"),
    "solvers": """
        from termsel import Generation, Solver, hookimpl
        class New(Solver):
            name = 'new'
            def generations(self, problem, rng): yield
        @hookimpl
        def termsel_solvers(): return [New]""",
    "criteria": """
        from termsel import Criterion, hookimpl
        class New(Criterion):
            name = 'new'
            def score(self, fits): return abs(fits.check_errors).max(axis=(1, 2))
        @hookimpl
        def termsel_criteria(): return [New]""",
    "readers": """
        from termsel import Reader, hookimpl
        class New(Reader):
            name, summary = 'new', 'points'
            def sniff(self, path, head): return False
            def read(self, path): raise AssertionError
        @hookimpl
        def termsel_readers(): return [New]""",
    "writers": """
        from termsel import Writer, hookimpl
        class New(Writer):
            name, summary = 'new', 'points'
            def accepts(self, result): return False
            def write(self, result, path): raise AssertionError
        @hookimpl
        def termsel_writers(): return [New]""",
}

WRAPPERS = """
    from termsel import hookimpl, Affine
    class Last(Affine):
        '''An affine model.'''
        name = {name!r}
    @hookimpl({how})
    def termsel_models():
        {body}
"""

ENDLESS = {
    "import": ("import time\nwhile True: time.sleep(0.01)\n", "cannot be imported"),
    "hook": ("""
        import time
        from termsel import hookimpl
        @hookimpl
        def termsel_models():
            while True: time.sleep(0.01)""", "termsel_models"),
    "wrapper": ("""
        import time
        from termsel import hookimpl
        @hookimpl(wrapper=True)
        def termsel_models():
            lists = yield
            while True: time.sleep(0.01)""", "termsel_models: as a wrapper"),
}
