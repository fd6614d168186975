"""What worlds hide, and the lab that measures them: laws that no model of the product knows, and what draws from them.

Nothing that searches, calibrates or answers imports this package; a contract of imports holds it.
"""
