"""How the processes of a deployed team talk: messages, what is believed of them, and Zenoh below."""
