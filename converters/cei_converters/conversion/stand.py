"""Where the target stands in a conversion that is to find it: searched as it is begun, known as it is gone on with."""

from rich.progress import Progress, TaskID

from cei_converters.conversion.config import AUTO, ConvertConfig
from cei_converters.conversion.converter import Converter
from cei_converters.conversion.placing import PLACE_PICTURE, as_option, note_on_simulation, record, told
from cei_converters.conversion.plan import PLACED, Plan
from cei_converters.conversion.staging import StagingDirectory


def stand(
    config: ConvertConfig,
    place: StagingDirectory,
    begun: Plan | None,
    converter: Converter,
    progress: Progress,
    task: TaskID,
) -> None:
    """Stand the target where it does best, or where that was found as the conversion was begun; where a pose is given, it stands there
    already.

    Args:
        config, place, converter: of the conversion.
        begun: the plan that is gone on with.
        progress, task: where the search shows how far it is.

    Raises:
        CEIError: an episode cannot be read, or the target cannot be verified there.
    """
    if config.target_pose != AUTO:
        return
    if begun is not None:
        converter.placed = begun.provenance.options.get(PLACED)
        converter.stand(begun.config.target_pose)
        return
    placement = converter.find_place(
        lambda total: progress.reset(task, total=total, description="finding the target's place"),
        lambda done: progress.advance(task, done),
    )
    print(told(placement))
    converter.placed = record(placement)
    converter.stand(as_option(placement))
    if note := note_on_simulation(converter.transfer.target, placement, converter.environment.id):
        print(note)
    if not config.dry_run:  # for the dataset
        from cei_converters.conversion.place_picture import write_place_picture  # and matplotlib

        write_place_picture(place.folder / PLACE_PICTURE, placement)
