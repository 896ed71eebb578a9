"""Rival estimators and restorations of the benchmark tables; nothing else imports them."""
