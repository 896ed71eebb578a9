"""Rival estimators of the benchmark tables; nothing else imports them."""
