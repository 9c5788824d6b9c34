"""The paper's adversarial objective (Sec. V-B).

`airl.train_adversarial` trains encoder, reward and policy with the settings `airl.AdversarialSettings`; other rooms use
these two. `discriminator` has the discriminator's logits. Begin reading with `airl`.
"""
