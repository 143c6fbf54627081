"""Options, inputs, prompts and tables that commands share."""
