import pytest
import torch

from companion.control.observation import CONTRACTS
from sitl.training.encoders import CircularConvolution, NeighbourEncoder
from sitl.training.networks import FollowerActor, FollowerCritic, Policy, build
from sitl.training.settings import NetworkSettings

TRUTH = 9


def observed(contract: str, batch: int, seed: int = 0) -> dict[str, torch.Tensor]:
    random = torch.Generator().manual_seed(seed)
    inputs = CONTRACTS[contract].inputs
    seen = {name: torch.rand((batch, *shape), generator=random) for name, shape in inputs.items()}
    return {**seen, "privileged": torch.rand((batch, TRUTH), generator=random)}


def built(contract: str = "best-2", **settings: object) -> tuple[FollowerActor, FollowerCritic]:
    return build(contract, NetworkSettings.model_validate(settings), TRUTH, seed=3)


def test_an_untrained_residual_policy_says_exactly_what_flock_says() -> None:
    actor, _ = built()
    seen = observed("best-2", 50)
    reference = torch.rand(50, 3) * 4.0 - 2.0
    seen["ego"][:, 10:13] = reference / 2.0
    assert torch.equal(actor(seen), reference)


def test_an_untrained_direct_policy_hardly_moves() -> None:
    actor, _ = built("paper-1", kind="paper", action="direct")
    assert float(actor(observed("paper-1", 50)).detach().abs().max()) < 0.05


@pytest.mark.parametrize(
    ("contract", "kind", "action"),
    [("best-2", "best", "residual"), ("best-2", "best", "direct"), ("paper-1", "paper", "direct")],
)
def test_the_exported_policy_is_the_actor(contract: str, kind: str, action: str) -> None:
    actor, critic = built(contract, kind=kind, action=action)
    seen = observed(contract, 7)
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.add_(0.01)
        inputs = {name: seen[name] for name in CONTRACTS[contract].inputs}
        assert torch.equal(Policy(actor)(**inputs), actor(seen))
    assert critic(seen).shape == (7, 1)


def test_the_published_network_has_the_published_sizes() -> None:
    actor, critic = built("paper-1", kind="paper", action="direct")
    paper = actor.encoder.paper
    assert paper is not None
    assert paper.flat.weight.shape == (256, 1728)
    assert paper.together.weight.shape == (512, 256 + 7 + 42)
    assert actor.mlp[0].weight.shape == (256, 512)
    assert critic.mlp[0].weight.shape == (256, 512)
    assert critic.shares
    actors, critics = ({id(p) for p in part.parameters()} for part in (actor, critic))
    assert not actors & critics


def test_convolutions_know_no_seam() -> None:
    layer = CircularConvolution(3, 5, 3, 2)
    columns = torch.rand(4, 72, 3)
    turned = layer(columns.roll(10, 1))
    assert torch.allclose(turned, layer(columns).roll(5, 1), atol=1e-6)


def test_a_convolution_is_a_sum_over_neighbouring_columns() -> None:
    layer = CircularConvolution(2, 1, 3, 2)
    columns = torch.rand(1, 8, 2)
    weights = layer.product.weight[0].reshape(3, 2)
    expected = [
        sum((weights[tap] * columns[0, (at + tap - 1) % 8]).sum() for tap in range(3)) + layer.product.bias[0]
        for at in range(0, 8, 2)
    ]
    assert torch.allclose(layer(columns)[0, :, 0], torch.stack(expected), atol=1e-6)


def test_neighbours_come_in_any_order_and_absent_rows_say_nothing() -> None:
    encoder = NeighbourEncoder(8, 16, 6, torch.nn.ELU())
    rows = torch.rand(5, 12, 8)
    rows[:, :, 6] = 0.0
    rows[:, :4, 6] = 1.0
    encoded = encoder(rows)
    mixed = rows[:, torch.randperm(12, generator=torch.Generator().manual_seed(1))]
    assert torch.allclose(encoder(mixed), encoded, atol=1e-6)
    rows[:, 4:, :6] = 99.0
    assert torch.equal(encoder(rows), encoded)
    alone = torch.zeros(1, 12, 8)
    assert torch.equal(encoder(alone), torch.zeros(1, 32))


def test_what_was_hit_follows_from_nearness() -> None:
    actor, critic = built()
    seen = observed("best-2", 6)
    both, one = seen, {**seen, "grid": seen["grid"][:, :1]}
    assert torch.equal(actor(both), actor(one))
    assert torch.equal(critic(both), critic(one))


def test_values_stay_when_their_scale_moves() -> None:
    _, critic = built()
    seen = observed("best-2", 40)
    returns = torch.randn(1000, generator=torch.Generator().manual_seed(2))
    critic.follow_scale(returns * 10.0 + 300.0)
    before = critic(seen)
    critic.follow_scale(returns * 50.0 + 100.0)
    assert torch.allclose(critic(seen), before, rtol=1e-4, atol=1e-3)
    assert float(critic.value_mean.detach()) == pytest.approx(200.0, abs=3.0)


def test_seeds_decide_the_first_weights_and_leave_the_process_alone() -> None:
    torch.manual_seed(5)
    undisturbed = torch.rand(3)
    torch.manual_seed(5)
    first, _ = built()
    assert torch.equal(torch.rand(3), undisturbed)
    again, _ = built()
    for one, other in zip(first.parameters(), again.parameters(), strict=True):
        assert torch.equal(one, other)
