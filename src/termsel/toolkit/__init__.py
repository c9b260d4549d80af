"""What more than one package builds on next to the names of `termsel`.

The names stand in the stubs next to each module, and are imported when first used. What one
package alone builds on is in a module by topic, such as `termsel.toolkit.files`.
"""

from termsel.core.stubs import lazily

__getattr__, __dir__, __all__ = lazily(__file__)
