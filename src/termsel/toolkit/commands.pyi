from termsel.cli.bars import search_bar as search_bar
from termsel.cli.messages import refuse_stdout as refuse_stdout
from termsel.cli.messages import say_once as say_once
from termsel.cli.options.run_options import COLUMNS_OPTION as COLUMNS_OPTION
from termsel.cli.options.run_options import RunOptions as RunOptions
from termsel.cli.options.run_options import run_options as run_options
from termsel.cli.options.run_options import take_reading as take_reading
from termsel.cli.options.shared import progress_option as progress_option
