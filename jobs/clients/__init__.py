"""Records about clients: keys, usage, webhooks, and requests to addresses that they name."""
